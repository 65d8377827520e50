"""Clocks in units longer than seconds, and a gyro of aircraft's axes."""

import numpy as np
import pytest

from qcar_twin.recordings.clock_units import unit_of_clock
from tests.qcar_twin.recordings.drives import drive
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log, speed_of


@pytest.mark.parametrize(
  ("name", "step", "last", "unit"),
  [
    ("time_h", 0.02 / 3600.0, 0.02, "hours"),
    ("datenum", 0.02 / 86400.0, 739000.2, "days"),
    ("Zeit", 0.02 / 86400.0, 45400.2, "days"),
    ("t_min", 1e-3 / 60.0, 0.5, "minutes"),
    ("time", 0.02, 60.0, "s"),
    ("hours", 0.02, 60.0, "s"),
    ("millis", 20.0, 6e4, "ms"),
    ("stamp", 2e7, 1.7e18, "ns"),
    ("a stamp a second", 1e9, 1.7e18, "ns"),
    ("nanoseconds since the start", 2e7, 1.5e9, "ns"),
  ],
)
def test_a_clocks_unit(name, step, last, unit):
  assert unit_of_clock(name, step, last)[1] == unit


def test_small_steps_without_a_name_or_a_date_stay_a_question_of_the_loader():
  assert unit_of_clock("t", 1e-7, 0.01) == (1.0, "s")


def test_a_gyro_of_aircrafts_axes_is_turned_where_the_place_is_geographic(tmp_path):
  time, own = drive(40.0)
  columns = {"throttle": own["motor_voltage"] / 8.0, "speed": speed_of(own), "steer": -own["steering_command"]}
  columns |= {"north": own["pose_x"], "east": -own["pose_y"], "yaw_deg": -np.degrees(own["pose_yaw"])}
  table, _ = log(tmp_path, time, columns | {"gyro_z": -np.degrees(own["yaw_rate"])})
  channels = table["channels"]
  assert channels["yaw_rate"]["scale"] < 0.0 and channels["steering_command"]["scale"] < 0.0
  assert channels["pose_yaw"]["scale"] < 0.0 and channels["pose_x"]["column"] == "east"


def test_both_of_two_speeds_without_a_sign_get_it(tmp_path):
  time, own = drive(40.0)
  back = np.where((time > 20.0) & (time < 30.0), -1.0, 1.0)
  speed = 0.7 * back * np.abs(speed_of(own)) + 0.02
  columns = {"throttle": speed / 4.0, "steer": own["steering_command"], "speed": np.abs(speed)}
  table, _ = log(tmp_path, time, columns | {"rpm": np.abs(speed) * 3000.0, "gyro_z": own["yaw_rate"] * back})
  assert {table["channels"][name]["signed_by"] for name in ("speed", "motor_speed")} == {"motor_duty"}
