"""Two axes of one sensor have one unit, and the sign of the one across is that of speed times yaw rate."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.scales.sensor import axes_of_one
from tests.faults.falsities import wander
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log

G = 9.80665


@pytest.mark.parametrize(
  ("one", "other", "same"),
  [
    ("imu/acl_x", "imu/acl_y", True),
    ("accX", "accY", True),
    ("ax", "ay", True),
    ("gyro.x [deg/s]", "gyro.y [deg/s]", True),
    ("imu/acl_x", "imu2/acl_y", False),
    ("acl_x", "gyr_y", False),
    ("acl_x", "acl_x", False),
    ("front", "fronx", False),
    ("acl_x", "acl_x_raw", False),
  ],
)
def test_names_that_differ_in_the_axis_alone(one, other, same):
  assert axes_of_one(one, other) is same


def logged(folder, across, heading=True, unit=G):
  time, own = wander(2)
  columns = {"throttle": own["motor_voltage"] / 8.0, "steer": own["steering_command"], "gyro_z": own["yaw_rate"]}
  columns |= {"speed": own["speed"], "imu/acl_x": own["accel_x"] / unit, "imu/acl_y": across * own["accel_y"] / G}
  columns |= {name: own[name] for name in ("pose_x", "pose_y", "pose_yaw")} if heading else {}
  return log(folder, time, columns)[0]["channels"]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_axis_to_the_right_has_its_sensors_unit_and_the_sign_that_the_heading_confirms(tmp_path, sign):
  channels = logged(tmp_path, sign)
  assert channels["accel_x"]["scale"] == pytest.approx(G, rel=1e-4)
  assert channels["accel_y"]["scale"] == pytest.approx(sign * G, rel=1e-4)


def test_without_a_heading_either_may_have_the_wrong_sign_and_none_is_turned(tmp_path):
  assert logged(tmp_path, -1.0, heading=False)["accel_y"]["scale"] == pytest.approx(G, rel=1e-4)


def test_an_axis_that_another_sensor_confirms_keeps_its_own_unit(tmp_path):
  channels = logged(tmp_path, G)
  assert "scale" not in channels["accel_y"] and channels["accel_x"]["scale"] == pytest.approx(G, rel=1e-4)


def test_what_the_axis_across_tells_holds_for_the_one_along(tmp_path):
  """A car that keeps its speed shows nothing along."""
  time, own = wander(3)
  rate = own["yaw_rate"] * 1.3 / np.maximum(own["speed"], 0.5)
  columns = {"throttle": 0.0 * time + 0.2 + 0.01 * np.sin(time), "speed": 0.0 * time + 1.3, "gyro_z": rate}
  columns |= {"steer": own["steering_command"], "imu/acl_x": own["accel_y"] * 0.01 / G, "imu/acl_y": 1.3 * rate / G}
  channels = log(tmp_path, time, columns)[0]["channels"]
  assert channels["accel_x"]["scale"] == channels["accel_y"]["scale"] == pytest.approx(G, rel=1e-4)
