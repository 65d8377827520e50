"""Ready-made maps: every column they name exists in messages of the kind, and a data set that names one loads."""

import numpy as np
import pytest

from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.topic_maps import topic_map, topic_maps
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.recordings.drives import drive, write_csv, write_manifest

TIME, COLUMNS = drive(12.0)


def logged(name, absent=()):
  """Columns of a log that a map was made for: the first choice of every channel, in the units of its topics."""
  speed = COLUMNS["motor_speed"] * 0.0953668 * 0.033
  values = COLUMNS | {"motor_duty": COLUMNS["motor_voltage"] / 12.0, "speed_command": speed, "speed": speed}
  columns_of = {}
  for channel, (columns, how) in topic_map(name).choices.items():
    if channel in values and channel not in absent:
      columns_of[columns[0].replace("*", "/any/topic")] = (values[channel] - how.offset) / how.scale
  return columns_of


@pytest.mark.parametrize("name", topic_maps())
def test_a_map_is_of_channels_and_of_a_car_that_can_be_built(name):
  mapping = topic_map(name)
  assert set(mapping.choices) <= set(CHANNELS) and set(mapping.choices) & set(DRIVE_COMMANDS)
  assert {"speed", "motor_speed"} & set(mapping.choices)
  assert Vehicle.from_dataset(mapping.vehicle).motor.channel in mapping.choices
  assert all(len(set(columns)) == len(columns) for columns, _ in mapping.choices.values())


@pytest.mark.parametrize("name", topic_maps())
def test_a_data_set_names_a_map_instead_of_channels(tmp_path, name):
  write_csv(tmp_path / "run.csv", TIME, logged(name))
  (run,) = DataSet.load(write_manifest(tmp_path, top=f'name = "lab"\nmap = "{name}"')).recordings
  expected = set(topic_map(name).choices) & (set(COLUMNS) | {"motor_duty", "speed_command", "speed"})
  assert set(run.channels) == expected
  for channel in set(run.channels) & set(COLUMNS):
    assert run[channel].value == pytest.approx(COLUMNS[channel], abs=1e-9)


def test_channels_of_the_data_set_go_before_those_of_the_map(tmp_path):
  write_csv(tmp_path / "run.csv", TIME, logged("ackermann") | {"gyro": 2.0 * COLUMNS["yaw_rate"]})
  channels = 'yaw_rate = { column = "gyro", scale = 0.5 }'
  (run,) = DataSet.load(write_manifest(tmp_path, top='name = "l"\nmap = "ackermann"', channels=channels)).recordings
  assert run["yaw_rate"].value == pytest.approx(COLUMNS["yaw_rate"]) and "speed_command" in run


def test_two_topics_that_could_be_meant_are_named(tmp_path):
  more = {"/other.twist.twist.linear.x": np.ones(TIME.size)}
  write_csv(tmp_path / "run.csv", TIME, logged("ackermann") | more)
  top = 'name = "l"\nmap = "ackermann"'
  with pytest.raises(
    RecordingError, match=r"run.csv: map 'ackermann' finds speed in several topics .*/other.*say which"
  ):
    DataSet.load(write_manifest(tmp_path, top=top))
  channels = 'speed = { column = "/any/topic.twist.twist.linear.x" }'
  assert "speed" in DataSet.load(write_manifest(tmp_path, top=top, channels=channels)).recordings[0]


def test_a_map_that_does_not_fit_and_one_that_does_not_exist_are_said(tmp_path):
  write_csv(tmp_path / "run.csv", TIME, COLUMNS)
  with pytest.raises(RecordingError, match="run.csv: map 'f1tenth' finds none of its columns .*/ackermann_cmd"):
    DataSet.load(write_manifest(tmp_path, top='name = "l"\nmap = "f1tenth"'))
  with pytest.raises(RecordingError, match="unknown map 'f1tent'; did you mean 'f1tenth'"):
    DataSet.load(write_manifest(tmp_path, top='name = "l"\nmap = "f1tent"'))
  with pytest.raises(RecordingError, match="map must be text"):
    DataSet.load(write_manifest(tmp_path, top='name = "l"\nmap = 3'))
