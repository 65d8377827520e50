"""A left-handed log, y upwards and z ahead: the wheels outside of its turns say which way it counts."""

import tomllib

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import write_csv

SIZE, TRACK, RADIUS = 10.4, 1.56, 0.335
MIRRORED = ("accel_y", "yaw_rate", "pose_y", "pose_yaw")


def log(folder, sides=1.0, wheels=True):
  """What is proposed for a full-size car's log whose x is to the right where `sides` is 1, to the left where -1."""
  time, own = wander(53, SIZE)
  random = np.random.default_rng(53)
  flat = lambda: 0.01 * random.standard_normal(time.size)
  columns = {
    "AccelerationX": -sides * own["accel_y"],
    "AccelerationY": flat(),
    "AccelerationZ": own["accel_x"],
    "AngularVelocityX": flat(),
    "AngularVelocityY": -sides * own["yaw_rate"],
    "AngularVelocityZ": flat(),
    "Yaw": np.angle(np.exp(-1j * sides * own["pose_yaw"])),
    "PositionX": -sides * own["pose_y"],
    "PositionY": 102.0 + flat(),
    "PositionZ": own["pose_x"],
    "Speed": own["speed"],
    "Throttle": own["motor_voltage"] / own["motor_voltage"].max(),
    "Steer": -sides * own["steering_command"],
    "CurrentEngineRpm": 900.0 + 3000.0 * np.abs(np.sin(time)),
  }
  for side, way in (("Left", -1.0), ("Right", 1.0)) if wheels else ():
    turned = (own["speed"] + way * 0.5 * TRACK * own["yaw_rate"]) / RADIUS
    columns[f"WheelRotationSpeedRear{side}"] = turned + 0.05 * random.standard_normal(time.size)
  write_csv(folder / "run.csv", time, columns)
  proposal = propose("lab", [read_table(folder / "run.csv")], wheelbase=0.256 * SIZE, mass=1480.0)
  return tomllib.loads(proposal.text), proposal


@pytest.mark.parametrize("sides", [1.0, -1.0])
def test_the_wheels_outside_of_turns_tell_a_left_handed_log(tmp_path, sides):
  table, proposal = log(tmp_path, sides)
  taken = table["channels"]
  columns = [taken[name]["column"] for name in ("accel_x", "accel_y", "yaw_rate", "pose_x", "pose_y")]
  assert columns == ["AccelerationZ", "AccelerationX", "AngularVelocityY", "PositionZ", "PositionX"]
  assert [taken[name].get("scale", 1.0) for name in MIRRORED] == [-sides] * 4
  assert np.sign(taken["steering_command"].get("scale", 1.0)) == -sides and not proposal.questions


def test_without_two_wheels_it_is_asked(tmp_path):
  _, proposal = log(tmp_path, wheels=False)
  (question,) = proposal.questions
  assert "'PositionY' points up" in question and "is left positive in this log?" in question


def test_wheels_rotate_in_radians_and_the_cars_own_speed_stays_in_metres(tmp_path):
  table, _ = log(tmp_path)
  taken = table["channels"]
  assert taken["motor_speed"]["column"] == "mean of WheelRotationSpeedRearLeft and WheelRotationSpeedRearRight"
  assert taken["speed"] == {"column": "Speed"}
  car = table["vehicle"]
  rolls = taken["motor_speed"]["scale"] * car["gear_ratio"] * car["wheel_radius"]
  assert rolls == pytest.approx(RADIUS, rel=0.03)


def test_a_speed_beyond_a_small_cars_is_in_metres_where_the_place_says_so(tmp_path):
  time, own = wander(53, 40.0)
  columns = {"velocity": 3.0 * own["speed"], "x": 3.0 * own["pose_x"], "y": 3.0 * own["pose_y"]}
  write_csv(tmp_path / "run.csv", time, columns | {"duty": own["motor_voltage"] / 20.0})
  text = propose("lab", [read_table(tmp_path / "run.csv")], wheelbase=2.6).text
  assert "in m/s, as the place shows" in text and "km/h" not in text
