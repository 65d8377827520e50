"""A log in files of a topic each, some of which have the same columns."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.parts.joined import as_one_drive
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from tests.qcar_twin.recordings.drives import drive, write_csv

TIME, OWN = drive(30.0)
TURN, ZERO, G = OWN["yaw_rate"], np.zeros(TIME.size), np.full(TIME.size, 9.81)


def tables(folder, files, clock=0.0, scale=1.0):
  for name, columns in files.items():
    write_csv(folder / f"{name}.csv", (TIME + clock) * scale, columns)
  return [read_table(folder / f"{name}.csv", f"{name}.csv") for name in files]


def autopilot():
  xyz = lambda *axes: {f"xyz[{k}]": axis for k, axis in enumerate(axes)}
  speed = OWN["motor_voltage"] / 4.0
  return {
    "log_7_vehicle_acceleration_0": xyz(OWN["accel_x"], -OWN["accel_y"], -G),
    "log_7_vehicle_angular_velocity_0": xyz(ZERO, ZERO, -TURN),
    "log_7_vehicle_local_position_0": {
      "x": OWN["pose_x"], "y": -OWN["pose_y"], "vx": speed * np.cos(OWN["pose_yaw"]), "heading": -OWN["pose_yaw"],
    },
    "log_7_actuator_motors_0": {"control[0]": OWN["motor_voltage"] / 8.0},
    "log_7_actuator_servos_0": {"control[0]": -OWN["steering_command"] / 0.5},
  }  # fmt: skip


def test_an_autopilots_topics_are_one_drive_and_gravity_tells_which_way_it_counts(tmp_path):
  whole = as_one_drive(tables(tmp_path, autopilot()))
  assert whole is not None
  proposal = propose("rover", [whole])
  assert not proposal.questions and not proposal.missing
  (turning,) = [line for line in proposal.channels if line.startswith("yaw_rate")]
  assert "angular_velocity_0.xyz[2]" in turning and "scale = -1.0" in turning


def test_drives_that_were_logged_alike_stay_drives_of_their_own(tmp_path):
  names = {"throttle": OWN["motor_voltage"], "gyro_z": TURN, "speed": OWN["motor_voltage"]}
  assert as_one_drive(tables(tmp_path, {"run_left_1": names, "run_right_1": dict(names)})) is None
  half = {"gyro_z": TURN, "speed": OWN["motor_voltage"]}
  assert as_one_drive(tables(tmp_path, {"run_1": half, "run_2": dict(half)})) is None


@pytest.mark.parametrize(("clock", "whole"), [(1.7e9, True), (0.0, False)])
def test_files_of_the_same_columns_at_one_date_are_one_drive(tmp_path, clock, whole):
  xyz = lambda *axes: dict(zip("zyx", axes, strict=True))
  files = {"Accelerometer": xyz(ZERO, OWN["accel_x"], -OWN["accel_y"]), "Gyroscope": xyz(TURN, ZERO, ZERO)}
  assert (as_one_drive(tables(tmp_path, files, clock)) is not None) is whole
