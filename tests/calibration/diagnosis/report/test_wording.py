"""Amounts read well, every mechanism of the catalogue can be told, and the verdict says what was found."""

import dataclasses

import pytest

from calibration.diagnosis.report.wording import (
  amount,
  claim_sentence,
  equation,
  happening,
  listed,
  sizes,
  unknown_words,
  unlike_sentence,
  verdict_sentence,
)
from qcar_twin.pages.numbers import spread
from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms import catalogue
from tests.calibration.diagnosis.diagnosis_results import claim_of, decision_of


@pytest.mark.parametrize(
  ("value", "std", "unit", "text"),
  [
    (0.041, 0.002, "s", "41.0 ± 2.0 ms"),
    (1.25, 0.1, "s", "1.25 ± 0.10 s"),
    (0.0262, 0.00175, "rad", "1.50 ± 0.10° (0.0262 rad)"),
    (0.056, 0.0031, "m", "56.0 ± 3.1 mm"),
    (0.052, 0.004, "-", "0.0520 ± 0.0040"),
    (0.2, 0.05, "m/s^2", "0.200 ± 0.050 m/s²"),
    (1234.0, 25.0, "N", "1234 ± 25 N"),
    (0.41, None, "kg", "0.41 kg"),
    (-0.03, 0.001, "rad/s", "-0.0300 ± 0.0010 rad/s"),
  ],
)
def test_amounts_in_units_that_read_well(value, std, unit, text):
  assert amount(value, std, unit) == text


def test_three_figures_unlike_the_class_are_named_and_the_others_counted():
  servo = Parameter("servo_time_constant", 0.005, 0.001, 0.2, "s", factor=3.0)
  assert unlike_sentence(()) == ""
  assert unlike_sentence([(servo, 0.172)]) == (
    " Unlike other cars of the class: servo time constant 172 ms instead of 5 ms."
  )
  assert unlike_sentence([(servo, 0.172)] * 5).endswith("; and 2 more.")


def test_spread_never_prints_noise_digits():
  assert spread(123456.0, 7890.0) == "123500 ± 7900"
  assert spread(0.5, 0.0) == "0.5"
  assert spread(0.5, float("nan")) == "0.5"


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_mechanism_can_be_told(name):
  mechanism = catalogue()[name]
  claim = claim_of(mechanism)
  sentence = claim_sentence(claim, mechanism)
  assert sentence.startswith(happening(mechanism)) and sizes(claim, mechanism)
  assert not happening(mechanism).endswith(".")
  stated = equation(mechanism)
  assert stated and "\n" not in stated
  assert "Units:" not in stated and "Source:" not in stated


def test_an_amplitude_at_its_declared_null_is_still_an_amplitude_but_shape_is_not():
  mechanism = catalogue()["steering_lag"]
  told = sizes(claim_of(mechanism), mechanism)
  assert "low-frequency lag" in told and "damping" not in told


def test_a_reader_in_a_hurry_learns_the_verdict():
  mechanisms = catalogue()
  decision = decision_of("explained", ("steering_delay",))
  sentence = verdict_sentence(decision, mechanisms, 0.93)
  assert sentence.startswith("The steering executes what was commanded a while ago: dead time 40.0 ± 2.0 ms")
  assert "probability 0.97" in sentence and "93 %" in sentence
  shares = verdict_sentence(
    decision, mechanisms, None, {"steering_delay": 0.931}, "yaw rate errs by 1.4 times the noise"
  )
  assert "probability 0.97, takes off 93 %)" in shares
  worse = verdict_sentence(decision, mechanisms, None, {"steering_delay": -0.04})
  assert "probability 0.97, adds 4 % to the error)" in worse
  rest = "The rest has no name, and no more structure than cars without a hidden effect show"
  assert shares.endswith(f"{rest}: yaw rate errs by 1.4 times the noise.")
  base = verdict_sentence(decision_of("no_mismatch", ()), mechanisms, short="yaw rate errs by 1.4 times the noise")
  assert "no missing physics" in base and "The twin itself falls short of them: yaw rate" in base
  nothing = verdict_sentence(decision_of("no_mismatch", ()), mechanisms)
  assert "no missing physics" in nothing
  partly = verdict_sentence(decision_of("partly_explained", ("steering_delay",)), mechanisms)
  assert "only part" in partly and "probability 0.97, lowered by what has no name)" in partly
  assert "lowered" not in sentence
  nameless = verdict_sentence(decision_of("unexplained", (), unknown="unknown_force_y"), mechanisms)
  assert "none of the known mechanisms" in nameless and "an unknown force across the car" in nameless
  near = dataclasses.replace(decision_of("unexplained", ()), nearest="The likeliest name is steering_lag.")
  assert verdict_sentence(near, mechanisms).endswith("explains. The likeliest name is steering_lag.")


def test_what_cannot_be_told_apart_is_said():
  decision = decision_of("explained", ("steering_delay",), equivalent=("steering_lag", "imu_latency"))
  assert "indistinguishable from steering_lag and imu_latency" in verdict_sentence(decision, catalogue())
  single = decision_of("explained", ("steering_delay",), equivalent=("steering_lag",))
  assert "indistinguishable from steering_lag)" in verdict_sentence(single, catalogue())


def test_small_words():
  assert listed([]) == "" and listed(["a"]) == "a" and listed(["a", "b"]) == "a and b"
  assert listed(["a", "b", "c"]) == "a, b and c"
  assert unknown_words("unknown_sensor_yaw_rate") == "an unknown error of the yaw rate sensor"
  assert unknown_words("unknown_something_else") == "an unknown something else"
