"""A recording that turned under a steering command which it does not hold is left out, and said."""

import numpy as np
import pytest

from calibration.log_check.ready import ready
from qcar_twin.recordings.dataset import DataSet
from tests.qcar_twin.recordings.drives import drive, write_csv, write_manifest


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
