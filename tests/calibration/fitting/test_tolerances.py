"""What recalibration allows for: bounds that give way once, and a sentence about what stopped at one."""

import dataclasses

import numpy as np
import pytest

from calibration.fitting.tolerances import (
  rather,
  stopped,
  unlike_the_class,
  unusual,
  widened,
  with_sensor_biases,
  with_tolerances,
)
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.mechanisms.floor_slope import LEVEL
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR

STIFFNESS = Parameter("stiffness", 500.0, 20.0, 2000.0, "N", factor=3.0)
GAIN = Parameter("gain", 1.0, 0.1, 10.0, "-")
MASS = Parameter("mass", 2.0, 1.0, 4.0, "kg", std=0.1)
AGE = Parameter("age", 0.0, 0.0, 0.015, "s", null=0.0, std=0.005)
TURNED = Twin(QCAR, select(["steering_gain_error"]))
ALL = ParameterSet([STIFFNESS, GAIN, MASS, AGE])


def test_bounds_of_open_and_class_figures_give_way_and_measured_ones_stay():
  wider = widened(ALL, np.array([20.0, 10.0, 4.0, 0.015]))
  assert (wider["stiffness"].lower, wider["stiffness"].upper) == (10.0, 2000.0)
  assert (wider["gain"].lower, wider["gain"].upper) == (0.1, 20.0)
  assert wider["mass"] == MASS and wider["age"] == AGE
  assert list(widened(ALL, ALL.nominal)) == list(ALL)


def test_what_stopped_at_a_bound_is_reported_and_what_is_absent_is_not():
  said = stopped(ALL, np.array([500.0, 1.0, 4.0, 0.0]), np.array([False, False, True, True]))
  assert "mass = 4 kg (measured, ±0.1)" in said and "age" not in said
  assert stopped(ALL, ALL.nominal, np.zeros(4, dtype=bool)) == ""
  assert "age = 0.015 s" in stopped(ALL, np.array([500.0, 1.0, 2.0, 0.015]), np.array([False, False, False, True]))


def test_a_class_figure_beyond_two_deviations_is_said_and_measured_or_open_ones_are_not():
  said = unusual(ALL, np.array([500.0 / 10.0, 9.0, 3.9, 0.014]))
  assert said == "unlike other cars of the class: stiffness = 50 N (usual are 500 N, class, a factor of 3)"
  assert unusual(ALL, np.array([500.0 / 8.0, 1.0, 2.0, 0.0])) == ""


def test_a_share_that_may_be_any_is_said_where_it_is_most_and_a_tolerance_is_not():
  share = Parameter("share", 0.0, 0.0, 1.0, "-", null=0.0, std=1.0 / 3.0, description="braking by short circuit")
  both = ALL + [share, dataclasses.replace(share, name="play", std=0.1)]
  said = rather(both, np.array([500.0, 1.0, 2.0, 0.015, 0.98, 0.9]))
  assert said == "which of two kinds this car is, the recordings tell: braking by short circuit (share = 0.98 of 1)"
  assert rather(both, np.array([500.0, 1.0, 2.0, 0.0, 0.4, 0.9])) == ""


def test_what_is_farthest_from_the_class_comes_first():
  both = ALL.replace(gain=dataclasses.replace(GAIN, factor=2.0))
  figures = unlike_the_class(both, np.array([50.0, 9.0, 2.0, 0.0]))
  assert [(p.name, value) for p, value in figures] == [("gain", 9.0), ("stiffness", 50.0)]


def test_every_model_lets_the_floor_be_as_far_out_of_level_as_floors_are():
  twin = Twin(QCAR, select(["floor_slope"]))
  fitted = with_tolerances(twin.base, twin)
  for name in ("floor_slope_x", "floor_slope_y"):
    allowed, declared = fitted[name], twin.parameters[name]
    assert allowed.std == LEVEL and (allowed.lower, allowed.upper) == (-3.0 * LEVEL, 3.0 * LEVEL)
    assert allowed.assumed and declared.std is None and declared.upper > 10.0 * LEVEL  # beyond: the mechanism's to find


@pytest.mark.parametrize(
  ("mechanism", "parameter", "most"),
  [
    ("steering_offset", "steering_offset", 0.0175),
    ("steering_backlash", "steering_play", 0.0175),
    ("steering_delay", "steering_delay", 0.02),
    ("steering_rate_limit", "steering_inverse_rate", 0.6),
    ("motor_heating", "motor_heating", 0.03),
    ("battery_sag", "battery_sag", 0.06),
    ("steering_asymmetry", "steering_asymmetry", 0.032),
    ("gyro_scale", "gyro_scale", 0.03),
    ("imu_misalignment", "imu_misalignment", 0.03),
    ("quadratic_drag", "quadratic_drag", 0.03),
    ("battery_discharge", "battery_discharge", 0.03),
    ("differential_lock", "differential_preload", 0.012),
  ],
)
def test_what_every_car_has_some_of_is_fitted_as_far_as_it_is_usual(mechanism, parameter, most):
  twin = Twin(QCAR, select([mechanism]))
  allowed, declared = with_tolerances(twin.base, twin)[parameter], twin.parameters[parameter]
  assert allowed.upper == pytest.approx(most) and allowed.std == pytest.approx(most / 3.0)
  assert allowed.lower == max(declared.lower, -allowed.upper)
  assert declared.typical > allowed.std and declared.upper > 2.0 * most


def logged(rate: float, name: str) -> Recording:
  time = np.arange(60) / rate
  return Recording("run", {"motor_voltage": Stream(time, 0.0 * time), name: Stream(time, 0.0 * time)})


@pytest.mark.parametrize(("mechanism", "channel"), [("encoder_latency", "motor_speed"), ("imu_latency", "yaw_rate")])
def test_a_sensor_may_be_as_old_as_half_a_period_of_its_log(mechanism, channel):
  """Counts differenced over a period of 20 ms are 10 ms old, which is no more than two deviations."""
  twin = Twin(QCAR, select([mechanism]))
  std = lambda rate: with_sensor_biases(twin.base, twin, [logged(rate, channel)])[mechanism].std
  for rate in (20.0, 50.0, 100.0):
    assert 0.5 / rate < 2.0 * std(rate) < 0.5 / rate + 0.011
  own = next(m.sensor_errors[mechanism].std for m in twin.mechanisms)
  assert std(1e4) == pytest.approx(own, rel=1e-3)


def test_the_speed_of_a_log_without_an_encoder_has_its_own_period():
  twin = Twin(QCAR, select(["encoder_latency"]))
  known = with_sensor_biases(twin.base, twin, [logged(20.0, "speed")])["encoder_latency"].std
  assert known == pytest.approx(np.hypot(np.hypot(0.003, 0.016), 0.0125))  # and what a filter takes


def test_a_steering_is_as_uncertain_as_its_full_lock_was_stated_to_be():
  """Most cars are told shares of full lock: a scale that nobody measured well is no error of the linkage."""
  usual = lambda std: with_tolerances(TURNED.base, twin_of(std))["steering_gain_error"].std
  twin_of = lambda std: Twin(dataclasses.replace(QCAR, std=dict(QCAR.std) | std), select(["steering_gain_error"]))
  assert usual({}) == pytest.approx(0.007)
  assert usual({"max_steering": 0.04 * QCAR.max_steering}) == pytest.approx(np.hypot(0.007, 0.04))
