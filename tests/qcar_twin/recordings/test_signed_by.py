"""A speed without a sign takes it from another channel: where the car backs, and not where a command brakes it."""

import re

import numpy as np
import pytest

from calibration.log_check.check import check_log
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.mapping import signed_by
from qcar_twin.recordings.recording import RecordingError
from tests.faults.thresholds import SOUND
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import folder_with, write_csv

KEPT = ("motor_voltage", "steering_command", "yaw_rate", "accel_y", "speed")


def backed():
  """Half of a drive in reverse; the log has the speed's size alone."""
  time, columns = SOUND["reverse"](*wander(31))
  own = {name: columns[name] for name in KEPT}
  return time, own, own | {"speed": np.abs(own["speed"])}


def slow_to_back(stops: bool):
  """Time, columns and the speed with its sign, of a car that answers in a second and is told to go back for a fifth of
  the time, which brings it to a stop and into reverse, or only brakes it."""
  time = np.arange(3000) / 50.0
  phase = time % 10.0
  duty = np.select([phase < 3.0, phase < 6.0, phase < 8.2], [0.3, 0.2, -0.15 if stops else -0.01], 0.1)
  steering = 0.3 * np.sin(1.3 * time)
  speed = np.zeros(time.size)
  for k in range(time.size - 1):
    speed[k + 1] = speed[k] + 0.02 * (10.0 * duty[k] - 0.9 * speed[k])
  turn = speed * np.tan(steering) / 0.256
  speed += 0.01 * np.random.default_rng(4).standard_normal(time.size)
  return time, {"motor_duty": duty, "steering_command": steering, "speed": np.abs(speed), "yaw_rate": turn}, speed


def test_the_steering_shows_that_a_slow_car_backed_for_a_short_while(tmp_path):
  time, logged, _ = slow_to_back(stops=True)
  (finding,) = check_log(DataSet.load(folder_with(tmp_path, time, logged))).of("spoils")
  assert 'set signed_by = "motor_duty" on speed' in finding.text
  text = propose("lab", [read_table(tmp_path / "run.csv")], wheelbase=0.256, mass=2.7).text
  assert 'signed_by = "motor_duty" }' in text


def test_a_car_that_is_braked_under_a_negative_command_has_lost_no_sign(tmp_path):
  time, logged, speed = slow_to_back(stops=False)
  assert speed[500:].min() > 0.1
  assert check_log(DataSet.load(folder_with(tmp_path, time, logged))).of("spoils") == ()
  _, backing, signed = slow_to_back(stops=True)
  assert check_log(DataSet.load(folder_with(tmp_path, time, backing | {"speed": signed}))).of("spoils") == ()


def test_a_command_that_brakes_turns_no_speed():
  time = np.arange(600) / 50.0
  speed = np.interp(time, [0.0, 2.0, 4.0, 5.0, 7.0, 9.0, 12.0], [0.0, 2.0, 2.0, 1.0, 2.0, -2.0, -2.0])
  command = np.where((time > 4.0) & (time < 5.0), -3.0, np.sign(speed) * 3.0)
  np.testing.assert_allclose(signed_by(np.abs(speed), command), speed, atol=0.03)


def test_new_writes_it_and_the_speed_is_as_driven(tmp_path):
  time, own, logged = backed()
  write_csv(tmp_path / "run.csv", time, logged)
  text = propose("lab", [read_table(tmp_path / "run.csv")], wheelbase=0.256, mass=2.7).text
  assert 'signed_by = "motor_voltage" }' in text and "backwards" in text
  (tmp_path / "dataset.toml").write_text(text, encoding="utf-8")
  for run in DataSet.load(tmp_path).recordings:
    driven = np.interp(run["speed"].time, time, own["speed"])
    steady = (np.abs(run["speed"].time - 48.0) > 0.5) & (run["speed"].time < 74.0)  # this drive's sign leaps there
    moves = (np.abs(driven) > 0.2) & steady
    np.testing.assert_allclose(run["speed"].value[moves], driven[moves], atol=0.01)


def test_the_cure_that_the_check_names_works(tmp_path):
  time, _, logged = backed()
  (finding, *_) = check_log(DataSet.load(folder_with(tmp_path, time, logged))).of("spoils")
  cure = re.search(r"set (signed_by = \"\w+\") on (\w+) in \[channels\]", finding.text)
  text = (tmp_path / "dataset.toml").read_text(encoding="utf-8")
  mapped = f'[channels]\n{cure[2]} = {{ column = "{cure[2]}", {cure[1]} }}\n'
  (tmp_path / "dataset.toml").write_text(text.replace("[[recording]]", f"{mapped}\n[[recording]]", 1), encoding="utf-8")
  assert check_log(DataSet.load(tmp_path)).of("spoils") == ()


def test_a_channel_that_is_not_there_is_refused_with_those_that_are(tmp_path):
  time, _, logged = backed()
  channels = 'speed = { column = "speed", signed_by = "gear" }'
  with pytest.raises(RecordingError, match="signed_by = 'gear', which is no other channel of this file; name one of"):
    DataSet.load(folder_with(tmp_path, time, logged, channels=channels))
