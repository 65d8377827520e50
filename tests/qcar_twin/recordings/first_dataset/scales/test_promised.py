"""Units that a message's type promises are tested by what a car can do, as those of any column are."""

import numpy as np
import pytest

from qcar_twin.recordings.channels import GRAVITY
from qcar_twin.recordings.dataset import DataSet
from tests.qcar_twin.recordings.first_dataset.test_other_tools import driven
from tests.qcar_twin.recordings.first_dataset.test_propose import DEG
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log

IMU = "/sensors/imu/raw"


def messages(gyro=1.0, force=1.0):
  """Topics of a VESC's driver; its IMU's numbers are those of its type times these."""
  time, own = driven()
  noise = 0.05 * np.random.default_rng(3).standard_normal((3, time.size))
  columns = {"/drive.drive.speed": own["speed"], "/drive.drive.steering_angle": own["steering_command"]}
  columns |= {"/odom.twist.twist.linear.x": own["speed"]}
  columns |= {f"{IMU}.angular_velocity.{axis}": gyro * 0.1 * row for axis, row in zip("xy", noise, strict=False)}
  columns |= {f"{IMU}.angular_velocity.z": gyro * own["yaw_rate"]}
  columns |= {f"{IMU}.linear_acceleration.{axis}": force * own[f"accel_{axis}"] for axis in "xy"}
  return time, own, columns | {f"{IMU}.linear_acceleration.z": force * (GRAVITY + noise[2])}


def test_a_vescs_degrees_and_g_are_scaled_before_the_map_counts(tmp_path):
  time, own, columns = messages(DEG, 1.0 / GRAVITY)
  table, proposal = log(tmp_path, time, columns)
  assert table["map"] == "f1tenth" and set(table["channels"]) == {"accel_x", "accel_y", "yaw_rate"}
  assert "too much for rad/s, so in deg/s" in proposal.text and "so in g" in proposal.text
  run = DataSet.load(tmp_path).recordings[0]
  for channel in ("yaw_rate", "accel_x", "accel_y"):
    assert run[channel].value == pytest.approx(own[channel][: len(run[channel])], abs=1e-6)


def test_units_that_were_kept_to_stay_the_maps(tmp_path):
  time, _, columns = messages()
  table, _ = log(tmp_path, time, columns)
  assert table["map"] == "f1tenth" and "channels" not in table
  assert DataSet.load(tmp_path).recordings
