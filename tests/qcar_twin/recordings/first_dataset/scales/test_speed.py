"""A speed whose name says no unit: read by what else moved, or asked about."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from tests.qcar_twin.recordings.drives import drive
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log, speed_of

G = 9.80665
UNITS = {"km/h": 1.0 / 3.6, "mph": 0.44704, "knots": 1852.0 / 3600.0}


def logged(folder, factor, *, accelerations=0.0, place=False, command=False, name="speed"):
  """A drive of 40 s under names without units; the speed in one of `factor` m/s, accelerations in one of m/s^2."""
  time, own = drive(40.0)
  speed = speed_of(own)
  columns = {"throttle": own["motor_voltage"] / 8.0, name: speed / factor, "gyro_z": own["yaw_rate"]}
  columns |= {"steer": own["steering_command"]}
  columns |= {"ax": own["accel_x"] / accelerations, "ay": own["accel_y"] / accelerations} if accelerations else {}
  columns |= {"x": own["pose_x"], "y": own["pose_y"]} if place else {}
  if command:
    del columns["throttle"]
    columns["target_speed"] = np.roll(speed, -20) / factor
  return speed, *log(folder, time, columns)


@pytest.mark.parametrize("accelerations", [1.0, G])
@pytest.mark.parametrize("unit", ["km/h", "mph", "knots"])
def test_two_accelerometers_tell_it(tmp_path, unit, accelerations):
  _, table, proposal = logged(tmp_path, UNITS[unit], accelerations=accelerations)
  assert table["channels"]["speed"]["scale"] == pytest.approx(UNITS[unit], rel=1e-6)
  assert [f"in {unit}, or in" in q for q in proposal.questions] == ([] if unit == "km/h" else [True])
  assert table["channels"]["accel_x"].get("scale", 1.0) == pytest.approx(accelerations, rel=1e-3)


@pytest.mark.parametrize("unit", UNITS)
def test_a_place_tells_it_where_the_gyro_confirms_the_clock(tmp_path, unit):
  speed, table, proposal = logged(tmp_path, UNITS[unit], place=True)
  assert table["channels"]["speed"]["scale"] == pytest.approx(UNITS[unit], rel=1e-6) and not proposal.questions
  read = np.concatenate([r["speed"].value for r in DataSet.load(tmp_path).recordings])
  assert read[:2000] == pytest.approx(speed[:2000], abs=1e-6)


def test_a_place_by_a_clock_at_another_speed_is_no_other_unit(tmp_path):
  time, own = drive(40.0)
  columns = {"throttle": own["motor_voltage"] / 8.0, "speed": speed_of(own), "gyro_z": own["yaw_rate"]}
  columns |= {"steer": own["steering_command"], "x": own["pose_x"], "y": own["pose_y"]}
  table, _ = log(tmp_path, time / 2.237, columns)
  assert "scale" not in table["channels"]["speed"]


def test_a_commanded_speed_is_in_the_unit_of_the_measured_one(tmp_path):
  _, table, _ = logged(tmp_path, 1.0 / 3.6, accelerations=1.0, command=True)
  assert table["channels"]["speed_command"]["scale"] == table["channels"]["speed"]["scale"]


def test_where_nothing_shows_it_a_person_is_asked_and_a_name_answers(tmp_path):
  _, _, proposal = logged(tmp_path, 1.0 / 3.6)
  (question,) = proposal.questions
  assert "'speed' names no unit" in question and "call the column 'speed [km/h]'" in question
  (tmp_path / "dataset.toml").unlink()
  _, table, proposal = logged(tmp_path, 1.0 / 3.6, name="speed [km/h]")
  assert not proposal.questions and table["channels"]["speed"]["scale"] == pytest.approx(1.0 / 3.6)


def test_a_speed_in_metres_per_second_is_not_asked_about(tmp_path):
  _, table, proposal = logged(tmp_path, 1.0)
  assert not proposal.questions and "scale" not in table["channels"]["speed"]


@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("mm", 1e-3), ("cm", 1e-2)])
def test_a_letter_is_a_speed_where_the_place_moves_as_fast_as_it_says(tmp_path, unit, factor):
  time, steps, place = stepped_drive()
  table, _ = log(tmp_path, time, {"cmd_v": steps, "X": 0.8 * place / factor, "Y": 0.6 * place / factor})
  assert table["channels"]["speed_command"]["column"] == "cmd_v" and "motor_voltage" not in table["channels"]
  assert table["channels"]["pose_x"].get("scale", 1.0) == pytest.approx(factor)


def test_a_letter_is_a_voltage_where_it_does_not(tmp_path):
  time, steps, place = stepped_drive()
  table, _ = log(tmp_path, time, {"cmd_v": 4.0 * steps, "X": 0.8 * place, "Y": 0.6 * place})
  assert table["channels"]["motor_voltage"]["column"] == "cmd_v"


def test_a_motors_commanded_turns_are_metres_by_the_speed_that_was_measured(tmp_path):
  time, steps, place = stepped_drive()
  columns = {"commands/motor/speed": steps * 5000.0, "speed": np.gradient(place, time), "gyro_z": 0.1 * np.sin(time)}
  table, _ = log(tmp_path, time, columns)
  assert table["channels"]["speed_command"]["scale"] == pytest.approx(1.0 / 5000.0, rel=0.03)


def stepped_drive():
  """Time, a speed in steps of 2 s, and the way of a car that follows it in 0.2 s, (k,) each."""
  random, time = np.random.default_rng(8), np.arange(3000) / 50.0
  steps = np.repeat(random.uniform(0.3, 1.8, 30), 100)
  speed = np.zeros(time.size)
  for k in range(1, time.size):
    speed[k] = speed[k - 1] + (steps[k - 1] - speed[k - 1]) / 10.0
  return time, steps, np.cumsum(speed) / 50.0
