"""Commanded and measured speeds that no name tells apart, and velocities along the axes of a map."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log

_RATE = 50.0


def ordered(seconds=60.0, seed=3):
  """Time, a commanded speed in steps, the speed that follows it in 0.2 s, an angle and the yaw rate, (k,) each."""
  random, time = np.random.default_rng(seed), np.arange(int(seconds * _RATE)) / _RATE
  steps = np.repeat(random.uniform(0.3, 1.8, int(seconds) // 2), int(2 * _RATE))
  speed = np.zeros(time.size)
  for k in range(1, time.size):
    speed[k] = speed[k - 1] + (steps[k - 1] - speed[k - 1]) / (0.2 * _RATE)
  angle = 0.3 * np.sin(1.1 * time)
  return time, steps, speed + 0.005 * random.standard_normal(time.size), angle, speed * np.tan(angle) / 0.256


def columns_of(table):
  return {channel: entry["column"] for channel, entry in table["channels"].items()}


def test_a_command_that_has_the_measured_channels_name_is_told_by_what_follows_it(tmp_path):
  time, steps, speed, angle, rate = ordered()
  names = {"poses_theta": np.cumsum(rate) / _RATE, "linear_vels_x": speed, "ang_vels_z": rate, "steer": angle}
  table, _ = log(tmp_path, time, names | {"speed": steps})
  taken = columns_of(table)
  assert taken["speed_command"] == "speed" and taken["speed"] == "linear_vels_x"
  assert "hold" not in table["channels"]["speed"] and table["vehicle"]["drive"] == "speed"
  assert len(DataSet.load(tmp_path).recordings[0]["speed"]) > 100


def test_of_two_speeds_in_another_language_the_one_that_goes_first_is_commanded(tmp_path):
  time, steps, speed, angle, rate = ordered()
  for soll, ist in (("Soll [m/s]", "Ist [km/h]"), ("B [m/s]", "A [km/h]")):
    names = {ist: 3.6 * speed, soll: steps, "Lenkwinkel [°]": np.degrees(angle), "Gierrate [°/s]": np.degrees(rate)}
    taken = columns_of(log(tmp_path, time, names, "Zeit [s]")[0])
    (tmp_path / "dataset.toml").unlink()
    assert (taken["speed_command"], taken["speed"]) == (soll, ist)
    assert (taken["steering_command"], taken["yaw_rate"]) == ("Lenkwinkel [°]", "Gierrate [°/s]")


@pytest.mark.parametrize(
  ("command", "measured", "meant"),
  [
    ("v_cmd", "v_meas", "speed_command"),
    ("cmd.v", "odom.v", "speed_command"),
    ("cmd [V]", "v_meas", "motor_voltage"),
    ("v_cmd", "motor_omega", "motor_voltage"),
  ],
)
def test_a_letter_means_one_quantity_in_a_log(tmp_path, command, measured, meant):
  time, steps, speed, angle, rate = ordered()
  values = speed / (0.0953668 * 0.033) if measured == "motor_omega" else speed
  table, _ = log(tmp_path, time, {command: steps, "delta_cmd": angle, measured: values, "psi_dot": rate})
  assert table["channels"][meant]["column"] == command


def test_a_second_speed_that_steps_is_the_command_where_no_other_is(tmp_path):
  """Autoware's Control message has longitudinal.velocity, its velocity report longitudinal_velocity."""
  time, steps, speed, angle, rate = ordered()
  names = {"longitudinal.velocity": steps, "longitudinal_velocity": speed, "steering_tire_angle": angle}
  taken = columns_of(log(tmp_path, time, names | {"heading_rate": rate})[0])
  assert (taken["speed_command"], taken["speed"]) == ("longitudinal.velocity", "longitudinal_velocity")


def test_the_speed_of_quansers_library_is_known(tmp_path):
  time, steps, speed, angle, rate = ordered()
  table, _ = log(tmp_path, time, {"throttle": steps / 10.0, "steering": angle, "motorTach": speed, "gyro_z": rate})
  assert table["channels"]["speed"] == {"column": "motorTach"}


def test_a_slow_sensor_that_holds_its_values_is_no_command(tmp_path):
  time, _, speed, angle, rate = ordered()
  held = np.repeat(speed[::25], 25)  # what satellites say twice a second, for half a second each
  table, _ = log(tmp_path, time, {"speed": held, "wheel_vel": speed, "steer": angle, "gyro_z": rate})
  assert columns_of(table)["speed"] == "wheel_vel" or table["channels"]["speed"]["hold"]
  assert "speed_command" not in table["channels"]


def test_a_velocity_along_the_maps_axes_is_no_speed_of_the_car(tmp_path):
  time, steps, speed, angle, rate = ordered()
  yaw = np.cumsum(rate) / _RATE + 0.4
  along = {"velocity_x": speed * np.cos(yaw), "velocity_y": speed * np.sin(yaw)}
  place = {"location_x": np.cumsum(along["velocity_x"]) / _RATE, "location_y": np.cumsum(along["velocity_y"]) / _RATE}
  rest = {"throttle": steps / 4.0, "steer_rad": angle, "yaw_rad": yaw}
  table, _ = log(tmp_path, time, rest | place | along)
  assert "speed" not in table["channels"]
  run = DataSet.load(tmp_path).recordings[0]["speed"]
  assert np.median(np.abs(run.value - np.interp(run.time, time, speed))) < 0.02
  (tmp_path / "dataset.toml").unlink()
  table, _ = log(tmp_path, time, rest | along | place | {"speed_kmh": 3.6 * speed})
  assert columns_of(table)["speed"] == "speed_kmh"
  (tmp_path / "dataset.toml").unlink()
  table, _ = log(tmp_path, time, rest | place | {"velocity_x": speed, "velocity_y": 0.01 * rate})
  assert columns_of(table)["speed"] == "velocity_x"


def test_the_only_speed_is_the_commanded_one_where_it_leaps_and_a_place_gives_the_cars(tmp_path):
  """A simulator's trace of discrete actions, each for a fifteenth of a second: no level stays for long."""
  random, time = np.random.default_rng(4), np.arange(900) / 15.0
  level = np.array([0.8, 1.2, 1.8])[np.clip(np.cumsum(random.integers(-1, 2, time.size)) % 5, 0, 2)]
  speed, angle = np.zeros(time.size), 0.3 * np.sin(1.1 * time)
  for k in range(1, time.size):
    speed[k] = speed[k - 1] + (level[k - 1] - speed[k - 1]) / (0.3 * 15.0)
  yaw = np.cumsum(speed * np.tan(angle) / 0.256) / 15.0
  place = {"x": np.cumsum(speed * np.cos(yaw)) / 15.0, "y": np.cumsum(speed * np.sin(yaw)) / 15.0}
  columns = {"speed": level, "steering_angle": np.degrees(angle), "yaw": np.degrees(np.angle(np.exp(1j * yaw)))}
  table, _ = log(tmp_path, time, columns | place)
  assert columns_of(table)["speed_command"] == "speed" and "speed" not in table["channels"]
  run = DataSet.load(tmp_path).recordings[0]
  assert (
    "speed" in run.derived and np.corrcoef(run["speed"].value, np.interp(run["speed"].time, time, speed))[0, 1] > 0.9
  )
