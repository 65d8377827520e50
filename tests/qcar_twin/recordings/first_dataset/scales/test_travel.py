"""Commands in counts: a blackbox's sticks, a radio's, a game's bytes; and what is current in the sense of now."""

import tomllib

import numpy as np

from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import VEHICLE, write_csv

DEG = 180.0 / np.pi
LOCK = VEHICLE["max_steering"]


def channels(folder, columns, **said):
  time, own = wander(51)
  write_csv(folder / "run.csv", time, columns(own))
  text = propose("lab", [read_table(folder / "run.csv")], **{"wheelbase": 0.256, "mass": 2.7, **said}).text
  return tomllib.loads(text)["channels"], text


def blackbox(own):
  still = np.zeros(own["speed"].size)
  turns = 60.0 / (2.0 * np.pi) * own["speed"] / (VEHICLE["wheel_radius"] * VEHICLE["gear_ratio"])
  return {
    "loopIteration": np.arange(still.size),
    "rcCommand[0]": np.round(-500.0 * own["steering_command"] / LOCK),
    "rcCommand[1]": still,
    "rcCommand[2]": still,
    "rcCommand[3]": np.round(1500.0 + 500.0 * own["motor_voltage"] / 8.0),
    "gyroADC[2]": np.round(-DEG * own["yaw_rate"]),
    "eRPM[0]": np.round(2.0 * turns / 100.0),
  }


def test_a_blackbox_has_sticks_pulses_and_hundreds_of_electrical_revolutions(tmp_path):
  taken, text = channels(tmp_path, blackbox, gear_ratio=VEHICLE["gear_ratio"], wheel_radius=VEHICLE["wheel_radius"])
  assert taken["motor_speed"]["column"] == "eRPM[0]"
  assert np.isclose(taken["motor_speed"]["scale"], 100.0 * np.pi / 30.0 / 2.0)
  assert taken["steering_command"]["column"] == "rcCommand[0]" and taken["motor_duty"]["column"] == "rcCommand[3]"
  assert np.isclose(taken["steering_command"]["scale"], LOCK / 500.0, rtol=0.1)  # both count to the right
  assert "a radio's stick that the car turned as" in text


def test_electrical_revolutions_elsewhere_are_no_hundreds(tmp_path):
  only = lambda own: {"duty": own["motor_voltage"] / 8.0, "eRPM[0]": 2000.0 * own["speed"], "gyro_z": own["yaw_rate"]}
  taken, _ = channels(tmp_path, only)
  assert np.isclose(taken["motor_speed"]["scale"], np.pi / 30.0 / 2.0)


def test_a_servo_that_no_turning_follows_gives_way_to_a_stick_that_it_does(tmp_path):
  another = lambda own: 1500.0 + 300.0 * np.sin(0.9 * np.arange(own["speed"].size) / 50.0)
  taken, _ = channels(tmp_path, lambda own: {**blackbox(own), "servo[5]": another(own)})
  assert taken["steering_command"]["column"] == "rcCommand[0]"
  served = lambda own: np.round(1500.0 - 450.0 * own["steering_command"] / LOCK)
  taken, _ = channels(tmp_path, lambda own: {**blackbox(own), "servo[5]": served(own)})
  assert taken["steering_command"]["column"] == "servo[5]"


def test_that_no_angle_turns_a_car_so_much_is_said_once(tmp_path):
  slow = lambda own: {"servo": own["steering_command"], "duty": own["motor_voltage"] / 8.0, "gyro_z": own["yaw_rate"]}
  _, text = channels(tmp_path, lambda own: {**slow(own), "speed [m/s]": 0.02 * own["speed"]})
  assert text.count("no angle turns a car as much") == 1


def radio(own):
  still = np.zeros(own["speed"].size)
  return {
    "GSpd(kmh)": 3.6 * own["speed"],
    "Hdg(°)": (90.0 - DEG * own["pose_yaw"]) % 360.0,
    "AccY(g)": -own["speed"] * own["yaw_rate"] / 9.80665,
    "Rud": still,
    "Ele": still,
    "Thr": np.round(1000.0 * own["motor_voltage"] / own["motor_voltage"].max()),
    "Ail": np.round(-1024.0 * own["steering_command"] / LOCK),
    "SA": np.full(still.size, -1024.0),
  }


def test_a_radios_sticks_go_to_1024_and_the_one_that_the_heading_follows_steers(tmp_path):
  taken, _ = channels(tmp_path, radio)
  assert np.isclose(taken["motor_duty"]["scale"], 1.0 / 1024.0)
  assert taken["steering_command"]["column"] == "Ail" and taken["pose_yaw"]["column"] == "Hdg(°)"
  assert np.isclose(abs(taken["steering_command"]["scale"]), LOCK / 1024.0, rtol=0.15)


def with_fixes(own):
  """The same with satellites, and accelerometers of which y points to the right; gravity is along z."""
  north, east = own["pose_y"] / 111_180.0, own["pose_x"] / 75_640.0  # degrees at a latitude of 47.3
  fixes = [f"{47.3 + a:.7f} {8.6 + b:.7f}" for a, b in zip(north, east, strict=True)]
  felt = {"AccX(g)": own["accel_x"] / 9.80665, "AccZ(g)": 1.0 + 0.01 * own["accel_x"]}
  return {"GPS": fixes, **felt, **radio(own)}


def test_a_place_of_satellites_tells_that_heading_stick_and_force_count_to_the_right(tmp_path):
  taken, text = channels(tmp_path, with_fixes)
  assert taken["pose_x"]["column"] == "gps.east" and taken["pose_yaw"]["scale"] < 0.0
  assert taken["accel_y"]["scale"] == -9.80665 and taken["steering_command"]["scale"] < 0.0
  assert "which is not a number" not in text


def bytes_of(own):
  slows = np.convolve(own["accel_x"], np.full(25, 1.0 / 25.0), "same") < -0.3
  gas = np.where(slows, 0.0, own["motor_voltage"])
  return {
    "Accel": np.round(255.0 * gas / gas.max()),
    "Brake": 100.0 * slows,
    "Steer": np.round(127.0 * own["steering_command"] / LOCK),
    "Speed": own["speed"],
    "CurrentLap": np.arange(own["speed"].size) / 100.0,
    "gyro_z": own["yaw_rate"],
  }


def test_a_games_pedals_are_bytes_and_its_steering_a_signed_one(tmp_path):
  taken, text = channels(tmp_path, bytes_of)
  assert taken["motor_duty"]["column"] == "Accel" and np.isclose(taken["motor_duty"]["scale"], 1.0 / 255.0)
  assert np.isclose(taken["steering_command"]["scale"], LOCK / 127.0, rtol=0.1)
  assert "a signed byte" in text and "in degrees" not in text


def test_a_current_lap_is_no_current(tmp_path):
  taken, _ = channels(tmp_path, bytes_of)
  assert "armature_current" not in taken and "motor_current" not in taken
