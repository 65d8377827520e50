"""Zeros that a sensor gives where it has no reading are no readings; a car that stops or reverses stays as it is."""

import numpy as np
import pytest

from qcar_twin.recordings.checks.dropouts import without_dropouts

TIME = np.arange(600) * 0.01
NOISE = np.random.default_rng(0).normal(0.0, 1.0, 600)
SPEED = 200.0 + 80.0 * np.sin(TIME) + NOISE


@pytest.mark.parametrize("length", [1, 3])
def test_single_zeros_between_others_are_blank(length):
  value, at = SPEED.copy(), np.array([40, 200, 333])
  hit = (at[:, None] + np.arange(length)).ravel()
  value[hit] = 0.0
  kept, notes = without_dropouts({"motor_speed": value}, {}, "drive.csv")
  assert np.array_equal(np.flatnonzero(np.isnan(kept["motor_speed"])), hit)
  assert notes == [
    f"drive.csv: motor_speed drops to 0 and back in {3 * length} samples, first in row 41, which no car does: no"
    " reading; left out"
  ]


@pytest.mark.parametrize("rows", [2, 5])
def test_zeros_of_a_loop_that_is_faster_than_its_sensor_are_blank(rows):
  """As an encoder's speed by the change of its count, asked for more often than it counts; near zero, too."""
  read = np.arange(600) % rows == 0
  speed = 200.0 * np.sin(np.pi * TIME / TIME[-1]) + NOISE
  kept, _ = without_dropouts({"motor_speed": np.where(read, speed, 0.0)}, {}, "drive.csv")
  assert np.array_equal(
    np.flatnonzero(np.isnan(kept["motor_speed"])), np.flatnonzero(~read)[: -((600 - 1) % rows) or None]
  )


@pytest.mark.parametrize(
  ("channel", "value"),
  [
    ("motor_speed", np.where(np.arange(600) % 4 == 0, 7.0, 0.0)),  # creeps: a count now and then
    ("motor_speed", np.where((TIME > 2.0) & (TIME < 2.05), 0.0, SPEED)),  # wheels that lock for 50 ms
    ("motor_speed", np.round(50.0 * np.sin(3.0 * TIME))),  # through zero, in whole steps
    ("motor_speed", np.where(TIME < 3.0, SPEED, 0.0)),  # stops, in one step
    ("accel_y", np.where(NOISE > 1.5, 0.0, NOISE)),  # no larger than its noise
    ("steering_command", np.where(np.arange(600) % 97 == 50, 0.0, 0.3)),  # a command of zero was given
  ],
)
def test_what_a_car_or_its_driver_does_stays(channel, value):
  kept, notes = without_dropouts({channel: value}, {}, "drive.csv")
  assert np.array_equal(kept[channel], value) and not notes


def test_a_speed_that_leaps_away_and_is_back_in_the_next_sample_is_blank():
  """A distance over a time that is too short, now and then twice within a few rows."""
  value, at = SPEED.copy(), np.array([40, 200, 203, 333])
  value[at] *= np.array([5.0, 12.0, 0.3, -1.0])
  kept, (note,) = without_dropouts({"motor_speed": value}, {}, "drive.csv")
  assert np.flatnonzero(np.isnan(kept["motor_speed"])).tolist() == at.tolist()
  assert note.startswith("drive.csv: motor_speed leaps away and back in 4 samples, first in row 41")


@pytest.mark.parametrize(
  "value",
  [
    SPEED + 30.0 * NOISE,  # a poor sensor
    np.where(np.arange(600) % 7 == 0, 7.0, 0.0),  # creeps
    np.where((TIME > 2.0) & (TIME < 2.05), 500.0, SPEED),  # wheels that spin for 50 ms
    np.where(TIME > 3.0, 5.0 * SPEED, SPEED),
  ],
)
def test_a_speed_that_stays_away_or_is_always_so_is_a_reading(value):
  kept, notes = without_dropouts({"motor_speed": value}, {}, "drive.csv")
  assert np.array_equal(kept["motor_speed"], value) and not notes


def test_a_pose_drops_out_whole_though_its_heading_is_near_zero_anyway():
  pose = {"pose_x": 3.0 + 0.01 * np.arange(600.0), "pose_y": 1.0 + 0.0 * TIME, "pose_yaw": 0.001 * np.sin(TIME)}
  for value in pose.values():
    value[300] = 0.0
  kept, notes = without_dropouts(pose, {}, "drive.csv")
  assert all(np.flatnonzero(np.isnan(value)).tolist() == [300] for value in kept.values()) and len(notes) == 3


def test_zero_is_what_the_file_has_before_its_offset():
  value = SPEED.copy()
  value[100] = 0.0
  kept, _ = without_dropouts({"motor_speed": value - 20.0}, {"motor_speed": -20.0}, "drive.csv")
  assert np.isnan(kept["motor_speed"][100])
