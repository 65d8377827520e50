"""Columns in another language: of several angles the one that the car turned by is the steering."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.parts.apart import runs_apart
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import Table, read_table
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import write_csv

GERMAN = {
  "motor_voltage": "Motorspannung [V]",
  "steering_command": "Lenkwinkel [rad]",
  "pose_yaw": "Gierwinkel [rad]",
  "speed": "Geschwindigkeit [m/s]",
  "yaw_rate": "Gierrate [rad/s]",
}


DUTCH = {
  "motor_voltage": "Motorspanning [V]",
  "steering_command": "Stuurhoek [rad]",
  "pose_yaw": "Gierhoek [rad]",
  "speed": "Snelheid [m/s]",
  "yaw_rate": "Giersnelheid [rad/s]",
}


def proposed(folder, names) -> str:
  time, columns = wander(51)
  write_csv(folder / "run.csv", time, {name: columns[channel] for channel, name in names.items()})
  return propose("lab", [read_table(folder / "run.csv")], wheelbase=0.256, mass=2.7).text


def test_of_two_angles_the_one_that_the_car_turned_by(tmp_path):
  text = proposed(tmp_path, DUTCH)
  assert 'steering_command = { column = "Stuurhoek [rad]"' in text and 'column = "Gierhoek' not in text


def test_a_heading_in_german_is_one(tmp_path):
  text = proposed(tmp_path, GERMAN)
  assert 'steering_command = { column = "Lenkwinkel [rad]"' in text
  assert 'pose_yaw = { column = "Gierwinkel [rad]"' in text


def test_degrees_in_the_logs_own_language_are_degrees(tmp_path):
  time, columns = wander(51)
  logged = {GERMAN[name]: columns[name] for name in ("motor_voltage", "speed")}
  logged |= {"Lenkwinkel [grad]": np.degrees(columns["steering_command"])}
  write_csv(tmp_path / "run.csv", time, logged | {"Gierrate [Grad/s]": np.degrees(columns["yaw_rate"])})
  text = propose("lab", [read_table(tmp_path / "run.csv")], wheelbase=0.256, mass=2.7).text
  assert 'steering_command = { column = "Lenkwinkel [grad]", scale = 0.01745329252 }' in text
  assert 'yaw_rate = { column = "Gierrate [Grad/s]", scale = 0.01745329252 }' in text


def test_a_compass_turns_clockwise_from_north_without_a_gyro_to_say_so(tmp_path):
  time, columns = wander(51)
  logged = {name: columns[name] for name in ("motor_voltage", "steering_command", "speed", "pose_x", "pose_y")}
  logged["compass"] = (90.0 - np.degrees(columns["pose_yaw"])) % 360.0
  write_csv(tmp_path / "run.csv", time, logged)
  text = propose("lab", [read_table(tmp_path / "run.csv")], wheelbase=0.256, mass=2.7).text
  assert 'pose_yaw = { column = "compass", scale = -0.01745329252, offset = 1.570796327, wrap = true }' in text


def test_a_speed_controllers_pulses_are_the_drives_command(tmp_path):
  time, columns = wander(52)
  own = {"ESC_us": 1500.0 + 60.0 * columns["motor_voltage"], "SERVO_us": 1500.0 - 900.0 * columns["steering_command"]}
  write_csv(tmp_path / "run.csv", time, own | {"v_mps": columns["speed"], "gyro_z": columns["yaw_rate"]})
  text = propose("lab", [read_table(tmp_path / "run.csv")], wheelbase=0.256, mass=2.7).text
  assert 'motor_duty = { column = "ESC_us", scale = 0.002, offset = -3.0 }' in text


def test_a_receivers_pulses_are_told_by_turning_and_by_speed(tmp_path):
  time, columns = wander(52)
  own = {"ch1": 1500.0 - 900.0 * columns["steering_command"], "ch3": 1500.0 + 60.0 * columns["motor_voltage"]}
  write_csv(tmp_path / "run.csv", time, own | {"v_mps": columns["speed"], "gyro_z": columns["yaw_rate"]})
  text = propose("lab", [read_table(tmp_path / "run.csv")], wheelbase=0.256, mass=2.7).text
  assert 'motor_duty = { column = "ch3", scale = 0.002, offset = -3.0 }' in text
  assert 'steering_command = { column = "ch1", scale = -0.00' in text


def test_a_command_of_no_known_name_is_told_by_the_speed_that_follows_it(tmp_path):
  time, columns = wander(52)
  own = {
    "u": np.roll(columns["motor_voltage"], -10),
    "delta": columns["steering_command"],
    "torque_est": np.abs(columns["yaw_rate"]),
  }
  write_csv(tmp_path / "run.csv", time, own | {"v": columns["speed"], "r": columns["yaw_rate"]})
  text = propose("lab", [read_table(tmp_path / "run.csv")], wheelbase=0.256, mass=2.7).text
  assert "# the speed follows 'u' (" in text and "map it, if that was commanded, as motor_voltage (V)" in text


@pytest.mark.parametrize(("stem", "taken"), [("control", True), ("state", False)])
def test_what_the_speed_follows_beside_the_steering_is_the_drives_command(stem, taken):
  """A message that holds sensors, too, is none of commands."""
  time, own = wander(5)
  columns = {"time": time, "state.vx": own["speed"], "imu.wz": own["yaw_rate"]}
  columns |= {f"{stem}.steer": own["steering_command"], f"{stem}.tau": np.roll(own["motor_voltage"], -10) / 12.0}
  made = propose("lab", [Table("run.csv", columns, {})])
  lines = [line for line in made.channels if line.startswith("motor_duty")]
  assert len(lines) == taken and (not taken or "control.tau" in lines[0])


def test_a_microcontrollers_counter_that_overflows_is_the_clock(tmp_path):
  time, own = wander(5)
  counted = np.mod(1e6 * time + 2.0**32 - 9e6, 2.0**32)
  columns = {"cnt": np.arange(time.size, dtype=float), "us": counted, "throttle": own["motor_voltage"] / 8.0}
  columns |= {"steer": own["steering_command"], "speed": own["speed"], "gyro_z": own["yaw_rate"]}
  runs = runs_apart([Table("run.csv", columns, {})])
  (line,) = [line for line in propose("lab", runs.tables).channels if line.startswith("time")]
  assert len(runs.tables) == 2 and 'column = "us", scale = 1e-06 }' in line


def test_a_lone_column_in_turns_a_minute_is_the_motors_speed():
  time, own = wander(5)
  columns = {"time": time, "Gas[%]": 12.5 * own["motor_voltage"], "Lenkung[rad]": own["steering_command"]}
  columns |= {"Kardandrehzahl[1/min]": 900.0 * own["speed"], "Drehrate[rad/s]": own["yaw_rate"]}
  made = propose("lab", [Table("run.csv", columns, {})])
  (line,) = [line for line in made.channels if line.startswith("motor_speed")]
  assert "Kardandrehzahl" in line and "scale = 0.1047" in line


@pytest.mark.parametrize("speed", [True, False])
def test_an_action_of_an_environment_steers_and_sets_a_speed_or_drives(tmp_path, speed):
  """A part that the speed reaches is commanded in m/s; one within 1 that it only follows is a duty."""
  random, time = np.random.default_rng(4), np.arange(3000) / 50.0
  level, steering = np.repeat(random.uniform(0.5, 3.0, 20), 150), 0.2 * np.sin(1.1 * time)
  reached = np.zeros(time.size)
  for k in range(1, time.size):
    reached[k] = reached[k - 1] + 0.02 * 5.0 * (level[k - 1] - reached[k - 1])
  turned = reached * np.tan(steering) / 0.256
  actions = np.stack([steering, level if speed else level / 8.0], axis=1)
  np.savez(tmp_path / "run.npz", time=time, linear_vels_x=reached, ang_vels_z=turned, actions=actions)
  text = propose("gym", [read_table(tmp_path / "run.npz")], wheelbase=0.256, mass=2.7).text
  assert 'steering_command = { column = "actions[0]" }' in text
  assert f'{"speed_command" if speed else "motor_duty"} = {{ column = "actions[1]"' in text
