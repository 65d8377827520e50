"""A speed that counts backwards is told by what the command and two other witnesses say, and by nothing less."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import Table
from tests.faults.wander import wander

TIME, DRIVEN = wander(78)
KEPT = ("motor_voltage", "steering_command", "yaw_rate", "accel_x", "speed")
NAMES = {"motor_voltage": "throttle", "steering_command": "steer", "yaw_rate": "gyro_z", "accel_x": "acc_x"}


def scales(*turned: str, without: tuple[str, ...] = (), also: tuple[str, ...] = ()) -> dict[str, float]:
  """Sign of each channel's scale in the draft of a log in which some channels count the other way."""
  columns = {"time": TIME}
  for name in (*KEPT, *also):
    if name not in without:
      columns[NAMES.get(name, name)] = DRIVEN[name] * (-1.0 if name in turned else 1.0)
  lines = propose("lab", [Table("run.csv", columns, {})]).channels
  signs = {line.split(" = ")[0]: -1.0 if "scale = -" in line else 1.0 for line in lines if " = {" in line}
  return {name: sign for name, sign in signs.items() if name != "time"}


def test_a_speed_that_counts_backwards_is_turned_and_nothing_else():
  """As of a motor controller whose driver negates it: command, accelerometer and steering are of one mind."""
  assert [name for name, sign in scales("speed").items() if sign < 0.0] == ["speed"]


def test_a_command_that_counts_backwards_is_turned_where_the_speed_has_two_witnesses():
  """As of a speed controller that was wired the other way: all of the driving is under negative commands."""
  assert [name for name, sign in scales("motor_voltage").items() if sign < 0.0] == ["motor_duty"]


def test_a_path_along_the_heading_is_a_witness():
  pose = ("pose_x", "pose_y", "pose_yaw")
  assert scales("speed", without=("accel_x",), also=pose)["speed"] < 0.0


@pytest.mark.parametrize(
  ("turned", "without"),
  [
    ((), ()),
    (("steering_command",), ()),  # a servo that counts to the right
    (("accel_x", "steering_command"), ()),  # and an IMU that lies reversed
    (("motor_voltage",), ("accel_x",)),  # a command of its own, with no second witness: the check asks
    (("speed",), ("accel_x",)),  # no second witness
  ],
)
def test_without_two_witnesses_it_stays(turned, without):
  assert scales(*turned, without=without)["speed"] > 0.0


@pytest.mark.parametrize("behind", [False, True])
def test_a_heading_that_points_backwards_is_turned_where_it_alone_tells(behind):
  """As of a camera whose z axis points backwards: without a speed, the car goes where its command drives it."""
  columns = {"time": TIME, "throttle": np.abs(DRIVEN["motor_voltage"]) / 8.0, "steer": DRIVEN["steering_command"]}
  columns |= {name: DRIVEN[name] for name in ("pose_x", "pose_y")}
  columns["pose_yaw"] = DRIVEN["pose_yaw"] + (np.pi if behind else 0.0)
  line = next(one for one in propose("lab", [Table("run.csv", columns, {})]).channels if one.startswith("pose_yaw"))
  assert ("offset = 3.14159" in line and "it points backwards" in line) is behind


@pytest.mark.parametrize("quarter", [1.0, -1.0])
@pytest.mark.parametrize("speed", [True, False])
def test_a_heading_a_quarter_turn_off_goes_by_which_way_the_car_is_driven(quarter, speed):
  """As of a rigid body whose x axis was across the car when motion capture was taught it."""
  columns = {"time": TIME, "throttle": np.abs(DRIVEN["motor_voltage"]) / 8.0, "steer": DRIVEN["steering_command"]}
  columns |= {name: DRIVEN[name] for name in ("pose_x", "pose_y")} | ({"speed": DRIVEN["speed"]} if speed else {})
  columns["pose_yaw"] = DRIVEN["pose_yaw"] - quarter * 0.5 * np.pi
  line = next(one for one in propose("lab", [Table("run.csv", columns, {})]).channels if one.startswith("pose_yaw"))
  offset = float(line.split("offset = ")[1].split(",")[0].split(" ")[0])
  assert offset == pytest.approx(quarter * 0.5 * np.pi, abs=0.05)


def test_a_clock_of_another_topic_is_no_command():
  """ArduPilot's message of the throttle is THR, and its clock THR.TimeUS; the rows of other messages are blank."""
  columns = {"time": TIME, "STER.SteerIn": DRIVEN["steering_command"], "GPS.Spd": DRIVEN["speed"]}
  columns |= {"THR.TimeUS": 1e6 * TIME, "THR.ThrIn": 12.5 * DRIVEN["motor_voltage"], "THR.AccX": DRIVEN["accel_x"]}
  for name in columns.keys() - {"time"}:
    columns[name] = np.where(np.arange(TIME.size) % 2 == name.startswith("THR"), columns[name], np.nan)
  made = propose("lab", [Table("run.csv", columns, {})])
  (line,) = [line for line in made.channels if line.startswith("motor_duty")]
  assert 'column = "THR.ThrIn"' in line and not made.questions


def test_counts_a_second_are_no_speed_where_another_column_may_be_it():
  columns = {"time": TIME, "throttle": DRIVEN["motor_voltage"] / 8.0, "steer": DRIVEN["steering_command"]}
  columns |= {"motorTach": 1.5e5 * DRIVEN["speed"], "linearSpeed": DRIVEN["speed"], "gyro_z": DRIVEN["yaw_rate"]}
  (line,) = [one for one in propose("lab", [Table("run.csv", columns, {})]).channels if one.startswith("speed = ")]
  assert 'column = "linearSpeed"' in line


@pytest.mark.parametrize(("name", "clockwise"), [("GPS Heading [deg]", True), ("imu heading [deg]", False)])
def test_a_heading_of_gps_alone_counts_as_a_compass(name, clockwise):
  columns = {"time": TIME, "throttle": DRIVEN["motor_voltage"] / 8.0, "steer": DRIVEN["steering_command"]}
  columns |= {"speed": DRIVEN["speed"], "yaw_rate": DRIVEN["yaw_rate"], "accel_y": DRIVEN["accel_y"]}
  columns[name] = np.mod(90.0 - np.rad2deg(DRIVEN["pose_yaw"]), 360.0)
  line = next(one for one in propose("lab", [Table("run.csv", columns, {})]).channels if one.startswith("pose_yaw"))
  assert ("scale = -0.01745" in line) is clockwise


def test_a_course_of_gps_once_a_second_is_a_compass_in_degrees():
  """Between two of them a car turns by a quarter of a turn, and its course is that about the middle one."""
  columns = {"time": TIME, "throttle": DRIVEN["motor_voltage"] / 8.0, "steer": DRIVEN["steering_command"]}
  columns |= {"wheel_speed [m/s]": DRIVEN["speed"], "gyro_z": DRIVEN["yaw_rate"]}
  spoken = np.arange(TIME.size) % 50 == 25
  for name, values in (("east", DRIVEN["pose_x"]), ("north", DRIVEN["pose_y"]), ("bearing", DRIVEN["pose_yaw"])):
    course = np.mod(90.0 - np.rad2deg(values), 360.0) if name == "bearing" else values
    columns[name] = np.where(spoken, course, np.nan)
  line = next(one for one in propose("lab", [Table("run.csv", columns, {})]).channels if one.startswith("pose_yaw"))
  assert "scale = -0.01745329252, offset = 1.570796327, wrap = true" in line


@pytest.mark.parametrize("turned", [False, True])
def test_a_telephone_s_y_is_forwards_where_speed_and_turning_say_so(turned):
  """Gravity taken off, as by its own app: nothing else tells how it lies."""
  columns = {"time": TIME, "throttle": DRIVEN["motor_voltage"] / 8.0, "steer": DRIVEN["steering_command"]}
  columns |= {"speed [m/s]": DRIVEN["speed"], "gyro_z": DRIVEN["yaw_rate"]}
  ahead, left = DRIVEN["accel_x"], DRIVEN["accel_y"]
  columns |= {"acc_x": -left if turned else ahead, "acc_y": ahead if turned else left}
  lines = propose("lab", [Table("run.csv", columns, {})]).channels
  taken = {one.split(" = ")[0]: one for one in lines if one.startswith("accel")}
  assert f'column = "acc_{"y" if turned else "x"}"' in taken["accel_x"] and "scale" not in taken["accel_x"]
  assert f'column = "acc_{"x" if turned else "y"}"' in taken["accel_y"]
  assert ("scale = -1.0" in taken["accel_y"]) is turned


@pytest.mark.parametrize(("name", "is_clock"), [("frame", False), ("id", False), ("millis", True)])
def test_a_number_of_the_row_is_no_clock(name, is_clock):
  columns = {name: np.arange(TIME.size, dtype=float), **{NAMES.get(n, n): DRIVEN[n] for n in KEPT}}
  made = propose("lab", [Table("run.csv", columns, {})])
  assert ("time" not in made.missing) is is_clock
