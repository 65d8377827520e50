"""Recordings that begin while the car drives."""

import numpy as np

from calibration.concealed.benchmarks.under_way import begun_under_way, under_way_cases
from qcar_twin.recordings.recording import Recording


def recording(largest: float = 200.0) -> Recording:
  time = 0.01 * np.arange(800)
  speed = largest * (1.0 - np.exp(-np.maximum(time - 1.0, 0.0) / 0.3))
  return Recording.from_columns("r", time, {"motor_speed": speed, "yaw_rate": time})


def test_a_recording_begins_in_its_launch_or_later():
  launch = begun_under_way(recording(), True)
  assert launch["motor_speed"].value[0] == np.min(launch["motor_speed"].value) > 0.35 * 199.0
  assert launch.start == 0.0 and launch["yaw_rate"].value[0] > 1.0
  assert begun_under_way(recording(), False)["yaw_rate"].value[0] >= 0.2 * 7.99


def test_a_car_that_stands_is_left_alone():
  still = recording(1.0)
  assert begun_under_way(still, True) is still


def test_either_car_drives_the_same_seeds():
  assert under_way_cases(5, 2) == [("first", 5), ("first", 6), ("second", 5), ("second", 6)]
