"""The mean of an axle's two wheels, whose names differ by their side."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.names import readings
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from tests.qcar_twin.recordings.drives import VEHICLE, drive, write_csv

TIME, OWN = drive(40.0)
SPEED = OWN["motor_speed"] * VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"]
TURN = 0.5 * VEHICLE["track_width"] * OWN["yaw_rate"]


def table(folder, columns):
  return read_table(write_csv(folder / "run.csv", TIME, columns), "run.csv")


@pytest.mark.parametrize(
  ("left", "right", "channel"),
  [
    ("speed_rl", "speed_rr", "speed"),
    ("v_Rad_HL", "v_Rad_HR", "speed"),
    ("lbSpeed", "rbSpeed", "speed"),
    ("WheelSpeed_RL_kph", "WheelSpeed_RR_kph", "speed"),
    ("wheel_left_rad_s", "wheel_right_rad_s", "motor_speed"),
  ],
)
def test_left_and_right_have_their_mean_and_it_goes_before_either(tmp_path, left, right, channel):
  read = table(tmp_path, {left: SPEED - TURN, right: SPEED + TURN})
  mean = f"mean of {left} and {right}"
  assert read.number(mean, channel) == pytest.approx(SPEED)
  of = lambda name: next(one.score for one in readings(name) if one.channel == channel)
  assert of(mean) > of(left) and of(mean) > of(right)


def test_of_four_wheels_the_rear_ones_are_taken(tmp_path):
  names = ("wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr")
  read = table(tmp_path, dict.fromkeys(names, SPEED))
  assert [n for n in read.columns if n.startswith("mean of")] == ["mean of wheel_speed_rl and wheel_speed_rr"]


@pytest.mark.parametrize(
  "names",
  [("ticks_left", "ticks_right"), ("left_speed_cmd", "right_speed_cmd"), ("steer_l", "steer_r"), ("left", "right")],
)
def test_what_is_no_speed_of_a_wheel_has_no_mean(tmp_path, names):
  assert not [n for n in table(tmp_path, dict.fromkeys(names, SPEED)).columns if n.startswith("mean of")]


def test_a_draft_takes_the_mean(tmp_path):
  columns = {"throttle": OWN["motor_voltage"] / 8.0, "steer": OWN["steering_command"], "gyro_z": OWN["yaw_rate"]}
  read = table(tmp_path, columns | {"speed_rl": SPEED - TURN, "speed_rr": SPEED + TURN})
  (line,) = [line for line in propose("lab", [read]).channels if line.startswith("speed =")]
  assert 'column = "mean of speed_rl and speed_rr"' in line and np.std(TURN) > 0.02
