"""A recording that turned under a steering command which it does not hold is left out, and said."""

import numpy as np
import pytest

from calibration.log_check.ready import ready
from qcar_twin.recordings.checks.steered import without_dead_steering
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, RecordingError
from tests.qcar_twin.recordings.drives import VEHICLE, drive, write_csv, write_manifest


def data_set(tmp_path, **second):
  """Two files; the second is another drive without steering_command, with `second` in place of its columns."""
  time, columns = drive()
  write_csv(tmp_path / "a.csv", time, columns)
  time, columns = drive(seed=1, seconds=15.0)
  columns = {name: values for name, values in (columns | second).items() if name != "steering_command"}
  write_csv(tmp_path / "b.csv", time, {name: values for name, values in columns.items() if values is not None})
  return DataSet.load(write_manifest(tmp_path, ("a.csv", "b.csv")))


@pytest.mark.parametrize("second", [{}, {"yaw_rate": None}], ids=["gyro", "pose alone"])
def test_a_turn_without_its_command_is_left_out(tmp_path, second):
  data = data_set(tmp_path, **second)
  assert [r.name for r in data.recordings] == ["a"]
  assert any(said.startswith("b.csv: the car turned, and steering_command") for said in data.warnings)


def test_a_straight_run_needs_no_steering_command(tmp_path):
  straight = {"yaw_rate": 0.02 + 0.01 * np.random.default_rng(2).standard_normal(1500), "accel_y": None}
  data = data_set(tmp_path, **straight, pose_x=None, pose_y=None, pose_yaw=None)
  assert [r.name for r in data.recordings] == ["a", "b"]


def test_a_set_without_any_steering_stays_whole(tmp_path):
  time, columns = drive()
  write_csv(tmp_path / "a.csv", time, {name: values for name, values in columns.items() if name != "steering_command"})
  assert len(DataSet.load(write_manifest(tmp_path, ("a.csv",))).recordings) == 1


def test_a_car_that_turned_by_no_logged_command_is_judged_along_alone(tmp_path):
  time, columns = drive()
  write_csv(tmp_path / "a.csv", time, {name: values for name, values in columns.items() if name != "steering_command"})
  data = DataSet.load(write_manifest(tmp_path, ("a.csv",)))
  fitted, notes = ready(data)
  assert not {"yaw_rate", "accel_y", "pose_x", "pose_y", "pose_yaw"} & set(fitted.recordings[0].channels)
  assert any("the car turned, and no steering_command is logged" in note for note in notes)
  assert "yaw_rate" in data.recordings[0], "the check compares sensors with one another all the same"
  steered, _ = ready(data_set(tmp_path))
  assert "yaw_rate" in steered.recordings[0]


def dead_set(tmp_path, dead):
  """Two files, of which those in `dead` have a steering sensor that says 0.4 degrees whatever the car does."""
  for name, seed in (("a.csv", 0), ("b.csv", 1)):
    time, columns = drive(seed=seed)
    if name in dead:
      columns["steering_command"] = 0.007 + 3e-5 * np.random.default_rng(seed).standard_normal(len(time))
    write_csv(tmp_path / name, time, columns)
  return write_manifest(tmp_path, ("a.csv", "b.csv"))


def test_a_steering_that_stays_while_the_car_turns_is_no_command(tmp_path):
  data = DataSet.load(dead_set(tmp_path, ("b.csv",)))
  assert [r.name for r in data.recordings] == ["a"]
  assert any(said.startswith("b.csv: steering_command stays at 0.007 rad") for said in data.warnings)


def test_a_set_whose_every_steering_is_dead_is_refused(tmp_path):
  with pytest.raises(RecordingError, match=r"a.csv: steering_command stays at 0.007 rad .* take steering_command out"):
    DataSet.load(dead_set(tmp_path, ("a.csv", "b.csv")))


def test_a_steering_of_another_scale_and_one_circle_are_no_dead_ones():
  time, columns = drive()
  columns["steering_command"] = columns["steering_command"] / 20.0  # too small, and it goes with the turning
  scaled = Recording.from_columns("a", time, columns)
  speed = 1.0 + 0.5 * np.sin(0.5 * time)
  columns |= {"steering_command": 0.2 + 1e-4 * np.sin(time), "yaw_rate": 0.8 * speed}
  columns["motor_speed"] = speed / (VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"])
  circle = Recording.from_columns("b", time, columns)
  kept, notes = without_dead_steering([scaled, circle], VEHICLE)
  assert all("steering_command" in recording for recording in kept) and not notes
