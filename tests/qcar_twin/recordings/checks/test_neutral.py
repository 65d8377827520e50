"""The neutral of a drive is where driving says that the car stands, not a level under which it happened to stand."""

import numpy as np
import pytest

from calibration.log_check.commands import command_findings
from qcar_twin.recordings.checks.neutral import drive_neutral
from qcar_twin.recordings.recording import Recording

RATE = 50.0


def car(levels, seconds, neutral=0.0, friction=0.4, name="run") -> Recording:
  """A first-order car with dry friction, V, under `levels` that are held for so many seconds each; 1 m/s per V."""
  command = np.repeat(np.asarray(levels, dtype=float), round(seconds * RATE))
  speed, speeds = 0.0, []
  for volts in command:
    speeds.append(speed)
    push = volts - speed
    moved = speed + (push - np.sign(speed or push) * friction) / (0.3 * RATE)
    held = abs(push) < friction if speed == 0.0 else moved * speed < 0.0
    speed = 0.0 if held else moved
  noisy = np.array(speeds) + 0.005 * np.random.default_rng(1).standard_normal(command.size)
  return Recording.from_columns(
    name, np.arange(command.size) / RATE, {"motor_voltage": command + neutral, "speed": noisy}
  )


def both_ways(seconds=0.8, **about) -> Recording:
  """Driven and reversed at random levels without a rest, from a stand."""
  return car(np.random.default_rng(4).permutation([-1.6, -0.9, 0.8, 1.3, 1.8, 2.4] * 3), seconds, **about)


def test_a_set_that_starts_from_rest_and_is_never_let_go_has_no_neutral():
  runs = [both_ways(), car([0.9] * 4, 1.0, name="cruise"), car([0.0], 3.0, name="parked")]
  assert drive_neutral(runs, "motor_voltage") is None
  assert command_findings(runs) == []


@pytest.mark.parametrize("seconds", [1.0, 2.5])
def test_a_level_at_which_friction_held_the_car_is_no_neutral_where_it_drove_both_ways(seconds):
  pushed = car([0.35, 1.2, 2.0, -1.5, -2.2, 1.5, -1.2, 0.35, 1.0, 1.8], seconds)
  assert drive_neutral([pushed], "motor_voltage") is None


def test_small_steps_that_do_not_move_the_car_are_asked_about_as_a_neutral_and_not_taken_for_one():
  rising = car([0.35, 1.0, 1.5, 2.0, 2.5], 4.0)
  neutral = drive_neutral([rising], "motor_voltage")
  assert neutral is not None and not neutral.sure and neutral.value == pytest.approx(0.35)
  (finding,) = command_findings([rising])
  assert finding.severity == "beware" and "offset = -0.35" in finding.text


@pytest.mark.parametrize("neutral", [-2.0, 0.7, 6.0, 1500.0])
def test_a_neutral_is_found_beside_friction_and_a_parked_recording(neutral):
  rests = car([0.0, 1.2, 2.0, 0.0, -1.5, -2.2, 0.0], 2.5, neutral)
  parked = car([0.0], 5.0, neutral, name="parked")
  found = drive_neutral([rests, both_ways(neutral=neutral), parked], "motor_voltage")
  assert found is not None and found.sure and found.value == pytest.approx(neutral, abs=1e-6)


@pytest.mark.parametrize("neutral", [2.0, 6.0])
def test_a_neutral_to_which_a_car_that_only_goes_forward_is_let_go_is_sure(neutral):
  found = drive_neutral([car([0.0, 1.2, 2.0, 0.0, 1.5, 2.2, 0.0], 2.5, neutral)], "motor_voltage")
  assert found is not None and found.sure and found.value == pytest.approx(neutral, abs=1e-6)


@pytest.mark.parametrize("dead", [0.0, 0.4])
def test_a_speed_that_lost_the_sign_of_driving_backwards_is_refused_and_one_that_was_braked_is_not(dead):
  there = car([0.0, 1.2, 2.0, -1.5, -2.2, 1.5, -1.2, 0.0, 1.0, 1.8], 2.5)
  time, late = there["speed"].time, round(dead * RATE)
  speed = np.r_[np.zeros(late), there["speed"].value][: time.size]
  signless = Recording.from_columns(
    "run", time, {"motor_voltage": there["motor_voltage"].value, "speed": np.abs(speed)}
  )
  (finding,) = command_findings([signless])
  assert finding.severity == "spoils" and "has lost the sign of driving backwards" in finding.text
  braked = Recording.from_columns(
    "run", time, {"motor_voltage": there["motor_voltage"].value, "speed": np.maximum(speed, 0.0)}
  )
  assert not any("lost the sign" in f.text for f in command_findings([braked]))
