"""A logger of few letters: pulses, counts of magnets, a raw IMU, each told by how it behaves, or asked about."""

import tomllib

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import VEHICLE, write_csv

TIME, OWN = wander(57)
LOCK, STEP = VEHICLE["max_steering"], 0.01  # rad; m per count


def log(folder, counts=8192.0, **changed):
  """The draft for a log whose accelerometers count so many a g and whose gyro counts 65.5 a deg/s."""
  columns = {
    "p": np.round(1507.0 - 430.0 * OWN["steering_command"] / LOCK),
    "q": np.round(1500.0 + 400.0 * np.roll(OWN["motor_voltage"], -10) / OWN["motor_voltage"].max()),  # 0.2 s ahead
    "n": np.floor(np.cumsum(OWN["speed"]) * (TIME[1] - TIME[0]) / STEP),
    "gz": np.round(65.5 * np.degrees(OWN["yaw_rate"])),
    "ax": np.round(counts * OWN["accel_x"] / 9.80665),
    "ay": np.round(counts * OWN["accel_y"] / 9.80665),
  }
  columns["n"] = np.maximum.accumulate(np.maximum(columns["n"], 0.0))
  write_csv(folder / "run.csv", TIME, columns | changed)
  proposal = propose("lab", [read_table(folder / "run.csv")], wheelbase=0.256, mass=2.7)
  return tomllib.loads(proposal.text), proposal


def test_pulses_steer_and_drive_by_what_the_counts_of_a_wheel_follow(tmp_path):
  table, proposal = log(tmp_path)
  taken = table["channels"]
  assert taken["steering_command"]["column"] == "p" and taken["motor_duty"]["column"] == "q"
  assert taken["steering_command"]["scale"] < 0.0  # they count to the right, and the gyro to the left
  assert proposal.missing == ("motor_speed or speed",) and "speed" not in taken


def test_what_only_grows_and_stands_with_the_car_is_said_to_count(tmp_path):
  _, proposal = log(tmp_path, row=np.arange(TIME.size), lap=np.floor(TIME / 30.0))
  assert "'n' seems to count an encoder's steps" in proposal.text and 'column = "n", slope = true' in proposal.text
  assert "'row' seems" not in proposal.text and "'lap' seems" not in proposal.text


def test_counts_of_an_imu_are_asked_about_and_not_taken_for_mg(tmp_path):
  table, proposal = log(tmp_path)
  assert all("scale" not in table["channels"][name] for name in ("accel_x", "accel_y", "yaw_rate"))
  asked = [text for text in proposal.questions if "data sheet" in text]
  assert len(asked) == 2 and "'ax' and 'ay' hold counts" in asked[0] and "'gz' holds counts" in asked[1]


def test_an_accelerometer_in_mg_is_still_in_mg(tmp_path):
  table, _ = log(tmp_path, counts=1000.0)
  assert table["channels"]["accel_y"]["scale"] == pytest.approx(9.80665e-3)


def test_the_draft_can_be_read_once_its_questions_are_answered(tmp_path):
  _, proposal = log(tmp_path)
  lines = [line for line in proposal.text.splitlines() if not line.startswith("undecided")]
  speed = f'speed = {{ column = "n", slope = true, scale = {STEP} }}'
  lines = [speed if line.startswith("# motor_speed or speed") else line for line in lines]
  known = {"ax": 9.80665 / 8192.0, "ay": 9.80665 / 8192.0, "gz": np.pi / 180.0 / 65.5}
  text = "\n".join(lines)
  for column, scale in known.items():
    text = text.replace(f'column = "{column}" }}', f'column = "{column}", scale = {float(scale)!r} }}')
  (tmp_path / "dataset.toml").write_text(text, encoding="utf-8")
  (run, *_) = DataSet.load(tmp_path).recordings
  there = run["accel_y"].time
  assert np.corrcoef(run["accel_y"].value, np.interp(there, TIME, OWN["accel_y"]))[0, 1] > 0.99
  assert np.interp(run["speed"].time, TIME, OWN["speed"]) == pytest.approx(run["speed"].value, abs=0.6)
