"""What a log cannot tell is said: a scale that only accelerometers witness, an age, which way a heading points."""

import re

import numpy as np
import pytest

from calibration.log_check import check_log
from calibration.log_check.check import LogCheck
from qcar_twin.recordings.completed import completed
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from tests.faults.wander import Columns, wander
from tests.qcar_twin.recordings.drives import STD, VEHICLE


def checked(columns: Columns, time: np.ndarray) -> LogCheck:
  runs, _ = completed([Recording.from_columns("run", time, columns)], VEHICLE, "lab")
  return check_log(DataSet("lab", tuple(runs), VEHICLE, STD))


def about(check: LogCheck, words: str) -> list[str]:
  return [f.text for f in check.findings if f.severity != "note" and words in f.text]


@pytest.fixture(scope="module")
def driven() -> tuple[np.ndarray, Columns]:
  return wander(4)


@pytest.mark.parametrize("factor", [0.8, 1.3])
def test_a_scale_of_the_speed_that_only_accelerometers_witness_is_said_with_what_they_show(driven, factor):
  time, columns = driven
  alone = {name: v for name, v in columns.items() if name not in ("pose_x", "pose_y")}
  (text,) = about(checked(alone | {"speed": factor * columns["speed"]}, time), "scale of speed cannot be judged")
  shown = float(text.split("accel_y shows ")[1].split(" ")[0])
  assert shown == pytest.approx(1.0 / factor, abs=0.03)
  # what noise makes of it is no zero, and is not how well the scale is known
  chance = re.search(r"accel_y shows [0-9.]+ of .+?, ± ([0-9.e-]+) by its noise alone", text)
  assert chance is not None and 0.0 < float(chance.group(1)) < 0.05


def test_where_a_pose_witnesses_the_speed_its_scale_is_judged(driven):
  time, columns = driven
  assert not about(checked(columns, time), "scale of speed")
  assert about(checked(columns | {"speed": 1.3 * columns["speed"]}, time), "speed reads +30")


PLACE = ("motor_voltage", "steering_command", "pose_x", "pose_y")


def test_a_place_without_a_heading_judges_the_steering(driven):
  time, columns = driven
  alone = {name: columns[name] for name in PLACE}
  check = checked(alone, time)
  assert not check.of("spoils") and not about(check, "steering")
  wrong = checked(alone | {"steering_command": -columns["steering_command"]}, time)
  assert "steering_command" in wrong.of("spoils")[0].text
  degrees = checked(alone | {"steering_command": np.degrees(columns["steering_command"])}, time)
  assert "is steering_command in degrees? set scale = 0.01745" in degrees.of("spoils")[0].text


def test_a_gyro_that_reads_too_little_to_show_a_turn_is_named_and_not_the_steering(driven):
  time, columns = driven
  alone = {name: v for name, v in columns.items() if not name.startswith("pose")}
  (text,) = about(checked(alone | {"yaw_rate": np.radians(columns["yaw_rate"])}, time), "is yaw_rate in")
  assert "is yaw_rate in rad/s, read as deg/s? set scale = 57.3 on yaw_rate" in text


def test_a_pose_without_a_heading_judges_the_speed(driven):
  time, columns = driven
  without = {name: v for name, v in columns.items() if name != "pose_yaw"}
  assert not about(checked(without, time), "scale of speed") and not about(checked(without, time), "speed reads")
  assert about(checked(without | {"speed": 1.25 * columns["speed"]}, time), "speed reads +25")


def unsigned(columns: Columns) -> Columns:
  return columns | {"speed": np.abs(columns["speed"])}


def test_a_heading_turned_round_beside_a_speed_without_a_sign_is_found_by_the_command(driven):
  time, columns = driven
  columns = unsigned(columns)
  assert not checked(columns, time).of("spoils")
  (text,) = (f.text for f in checked(columns | {"pose_yaw": columns["pose_yaw"] + np.pi}, time).of("spoils"))
  assert "offset = 3.14159 on pose_yaw" in text
  by_hand = {name: v for name, v in columns.items() if name != "motor_voltage"}
  (text,) = (f.text for f in checked(by_hand | {"pose_yaw": columns["pose_yaw"] + np.pi}, time).of("spoils"))
  assert "offset = 3.14159 on pose_yaw" in text and "leave speed out" in text


def test_driving_in_reverse_under_a_speed_without_a_sign_is_found_and_the_cure_is_to_leave_it_out(driven):
  time, columns = driven
  sign = np.where((time > 48.0) & (time < 75.0), -1.0, 1.0)
  yaw = np.cumsum(sign * columns["yaw_rate"]) / 50.0
  speed = sign * columns["speed"]
  place = {"pose_x": np.cumsum(speed * np.cos(yaw)) / 50.0, "pose_y": np.cumsum(speed * np.sin(yaw)) / 50.0}
  backwards = columns | place | {"pose_yaw": yaw, "yaw_rate": sign * columns["yaw_rate"]}
  backwards |= {"motor_voltage": sign * columns["motor_voltage"], "speed": np.abs(speed)}
  backwards |= {"accel_x": sign * columns["accel_x"]}
  texts = [f.text for f in checked(backwards, time).of("spoils") if "leave speed out" in f.text]
  assert len(texts) == 1 and "3.14159" not in texts[0]
  assert not checked({name: v for name, v in backwards.items() if name != "speed"}, time).of("spoils")


def test_an_accelerometer_hardly_alike_whose_age_is_off_says_that_it_cannot_be_judged(driven):
  time, columns = driven
  noise = 1.2 * np.std(columns["accel_x"]) * np.random.default_rng(3).standard_normal(time.size)
  late = np.interp(time - 0.9, time, columns["accel_x"]) + noise
  check = checked(columns | {"accel_x": late}, time)
  assert check.of("spoils") or about(check, "accel_x")


def test_a_neutral_under_a_switch_that_makes_a_nought_of_it_is_asked_about(driven):
  time, columns = driven
  armed = np.where((time > 1.0) & (time < 80.0), 1.0, 0.0)
  voltage = columns["motor_voltage"]
  assert not about(checked(columns | {"motor_voltage": armed * voltage}, time), "if that is its neutral")
  off = armed * (voltage + 25.0)
  (text,) = about(checked(columns | {"motor_voltage": off}, time), "set offset = -25 on it")
  assert "motor_voltage" in text


def test_of_a_car_that_never_drives_it_is_said_first_that_nothing_can_be_fitted(driven):
  time, columns = driven
  parked = {name: np.full(time.size, values[0]) for name, values in columns.items()}
  parked |= {"speed": 0.02 * np.random.default_rng(5).standard_normal(time.size)}
  check = checked(parked, time)
  assert not check.of("spoils") and check.verdict.startswith("Nothing to be fitted: the car never drives: by speed it")


def test_seconds_of_driving_are_said_to_show_hardly_anything(driven):
  time, columns = driven
  short = time < time[0] + 1.25
  said = "of driving are to be fitted, less than one stretch of 6 s"
  assert len(about(checked({name: value[short] for name, value in columns.items()}, time[short]), said)) == 1
  assert not about(checked(columns, time), said)


def test_a_speed_and_a_steering_alone_leave_nothing_to_be_fitted(driven):
  time, columns = driven
  check = checked({name: columns[name] for name in ("speed", "steering_command")}, time)
  (text,) = [f.text for f in check.of("spoils")]
  assert "neither the drive nor turning can be judged, and nothing fitted" in text


def test_a_gyro_and_a_speed_alone_leave_nothing_to_be_fitted(driven):
  time, columns = driven
  check = checked({name: columns[name] for name in ("speed", "yaw_rate")}, time)
  (text,) = [f.text for f in check.of("spoils")]
  assert "neither a command of the drive nor of the steering" in text


def test_a_car_that_goes_round_faster_than_tyres_hold_has_a_speed_in_another_unit(driven):
  time, columns = driven
  alone = {name: columns[name] for name in ("motor_voltage", "steering_command", "speed", "yaw_rate")}
  fast = 4.0 * 9.81 / float(np.percentile(np.abs(columns["speed"] * columns["yaw_rate"]), 99.0))  # 4 g
  quick = alone | {"speed": fast * columns["speed"], "steering_command": columns["steering_command"] / fast}
  (text,) = about(checked(quick, time), "tyres hold 2 g at most")
  assert "set scale = 0.277778 on speed in [channels]" in text
  assert not about(checked(alone, time), "tyres hold")
  assert not about(checked(quick | {"accel_y": fast * columns["accel_y"]}, time), "tyres hold")


def test_a_motor_whose_gear_and_wheel_are_a_guess_is_said_to_be_that(driven):
  time, columns = driven
  travel = 1.7 * VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"]  # m of the car per radian of its motor
  alone = {name: columns[name] for name in ("motor_voltage", "steering_command", "accel_x", "accel_y", "yaw_rate")}
  texts = about(checked(alone | {"motor_speed": columns["speed"] / travel}, time), "gear_ratio times wheel_radius")
  assert texts and all(float(t.split("would be ")[1].split()[0]) == pytest.approx(1.7, rel=0.1) for t in texts)
