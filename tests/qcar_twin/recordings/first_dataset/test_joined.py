"""A file per topic: parts of one drive become one log, and drives of their own do not."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.parts.joined import JOINED, as_csv, as_one_drive, joined
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError
from scripts import new
from tests.qcar_twin.recordings.drives import drive, write_csv

EPOCH = 1764200000.25


def write_topic(path, clock, time, columns):
  """A CSV whose clock has a name of its own."""
  write_csv(path, time, columns)
  text = path.read_text(encoding="utf-8")
  path.write_text(text.replace("time", clock, 1), encoding="utf-8")


def parts(folder, late=0.0, clocks=("stamp", "header.stamp", "stamp")):
  """Files of a topic each, on clocks of their own, of which the first calls its column `data`."""
  time, own = drive(12.0)
  content = {
    "commands_motor_duty_cycle": ({"data": own["motor_voltage"] / 12.0}, 2, 0.0),
    "imu_data": ({"angular_velocity.z": own["yaw_rate"]}, 1, 0.003),
    "sensors_encoder": ({"motor_speed_rad_s": own["motor_speed"]}, 1, late + 0.001),
  }
  names = []
  for (name, (columns, every, shift)), clock in zip(content.items(), clocks, strict=True):
    stamps = EPOCH + time[::every] + shift
    write_topic(folder / f"{name}.csv", clock, stamps, {k: v[::every] for k, v in columns.items()})
    names.append(f"{name}.csv")
  return [read_table(folder / name, name) for name in names], time, own


def test_files_of_a_topic_each_become_one_log(tmp_path):
  tables, time, own = parts(tmp_path)
  whole = as_one_drive(tables)
  assert whole is not None and whole.rows == 2.5 * time.size
  (tmp_path / JOINED).write_text(as_csv(whole), encoding="utf-8")
  (tmp_path / "dataset.toml").write_text(propose("lab", [whole]).text, encoding="utf-8")
  run = DataSet.load(tmp_path).recordings[0]
  assert {"motor_duty", "yaw_rate", "motor_speed"} <= set(run.channels)
  count = len(run["motor_speed"])
  np.testing.assert_allclose(run["motor_speed"].value, own["motor_speed"][:count], rtol=1e-5, atol=1e-5)
  assert run["yaw_rate"].time[0] - run["motor_duty"].time[0] == pytest.approx(0.003, abs=1e-5)


def test_the_command_writes_one_log_and_replaces_none(tmp_path, capsys):
  files = tuple(tmp_path / table.label for table in parts(tmp_path)[0])
  folder = tmp_path / "lab"
  new.main(new.Config(folder, files, wheelbase=0.256, mass=2.7))
  assert sorted(p.name for p in folder.iterdir()) == ["dataset.toml", JOINED]
  assert "parts of one drive" in (said := capsys.readouterr().out) and "1 log," in said
  (folder / "dataset.toml").unlink()
  with pytest.raises(RecordingError, match="joined.csv: is there already and is not replaced"):
    new.main(new.Config(folder, files))


def test_drives_of_their_own_and_clocks_without_a_time_in_common_are_not_joined(tmp_path):
  tables, time, own = parts(tmp_path, late=100.0)
  assert as_one_drive(tables) is None
  assert as_one_drive(tables[:1]) is None
  columns = {name: own[name] for name in ("motor_voltage", "motor_speed", "yaw_rate")}
  for name in ("one.csv", "two.csv"):
    write_csv(tmp_path / name, time, columns)
  assert as_one_drive([read_table(tmp_path / name, name) for name in ("one.csv", "two.csv")]) is None


def test_a_stamp_that_repeats_is_kept_once_and_many_are_left_to_a_person(tmp_path):
  tables, time, own = parts(tmp_path)
  stamps = EPOCH + time
  for repeated in (1, len(stamps) // 4):
    stamps[1 : 2 * repeated : 2] = stamps[0 : 2 * repeated - 1 : 2]
    write_topic(tmp_path / "imu_data.csv", "header.stamp", stamps, {"angular_velocity.z": own["yaw_rate"]})
    whole = as_one_drive([tables[0], read_table(tmp_path / "imu_data.csv", "imu_data.csv"), tables[2]])
    assert (whole is None) is (repeated > 1)
    assert whole is None or "1 of" in whole.notes[0] and "repeat the stamp before them" in whole.notes[0]


def test_files_that_hold_a_command_and_its_answer_each_are_parts_of_one_drive(tmp_path):
  """ArduPilot's STER has the steering and the turn rate, THR the throttle and the speed."""
  _, time, own = parts(tmp_path)
  ster = {"SteerOut": own["steering_command"], "TurnRate": own["yaw_rate"]}
  thr = {"ThrOut": own["motor_voltage"] / 8.0, "Speed": 0.003 * own["motor_speed"]}
  for name, columns in (("STER", ster), ("THR", thr)):
    write_topic(tmp_path / f"{name}.csv", "timestamp", EPOCH + time, columns)
  read = lambda name: read_table(tmp_path / f"{name}.csv", f"{name}.csv")
  whole = as_one_drive([read("STER"), read("THR")])
  assert whole is not None and {"STER.SteerOut", "THR.Speed"} <= set(whole.columns)
  assert as_one_drive([read("THR"), dataclasses.replace(read("THR"), label="THR_2.csv")]) is None


def test_messages_of_which_two_share_a_name_are_parts_of_one_drive(tmp_path):
  """ArduPilot's IMU and THR both have AccX; no message has all, and two have a command with its answer."""
  _, time, own = parts(tmp_path)
  imu = {"GyrZ": -own["yaw_rate"], "AccX": own["accel_x"], "AccY": -own["accel_y"], "I": 0.0 * time}
  ster = {"SteerOut": -own["steering_command"], "TurnRate": -own["yaw_rate"]}
  thr = {"ThrOut": own["motor_voltage"] / 8.0, "Speed": 0.003 * own["motor_speed"], "AccX": own["accel_x"]}
  messages = {"IMU": (imu, 1, 0.0), "STER": (ster, 4, 0.013), "THR": (thr, 4, 0.013)}
  for name, (columns, every, shift) in messages.items():
    stamps = 1e6 * (183.0 + time[::every] + shift)
    write_topic(tmp_path / f"log_{name}.csv", "TimeUS", stamps, {k: v[::every] for k, v in columns.items()})
  drives = joined([read_table(tmp_path / f"log_{name}.csv", f"log_{name}.csv") for name in messages])
  assert len(drives.tables) == 1 and "parts of one drive" in drives.said[0]
  assert {"log_IMU.AccX", "log_THR.AccX", "log_STER.TurnRate"} <= set(drives.tables[0].columns)


@pytest.mark.parametrize("commands", ["actuator_controls_0_0", "outputs_0"])
def test_parts_whose_commands_have_names_that_nobody_knows_are_joined_and_asked_about(tmp_path, commands):
  """PX4's actuators are numbered, by its documentation, and its axes are those of aircraft."""
  time, own = drive(12.0)
  place = {"x": own["pose_x"], "y": -own["pose_y"], "heading": -own["pose_yaw"]}
  topics = {
    f"log_{commands}": {"control[2]": -own["steering_command"], "control[3]": own["motor_voltage"] / 8.0},
    "log_vehicle_angular_velocity_0": {"xyz[0]": 0.0 * time, "xyz[2]": -own["yaw_rate"]},
    "log_vehicle_local_position_0": place,
  }
  for name, columns in topics.items():
    write_topic(tmp_path / f"{name}.csv", "timestamp", 1e6 * (35.0 + time), columns)
  whole = as_one_drive([read_table(tmp_path / f"{name}.csv", f"{name}.csv") for name in topics])
  assert whole is not None
  proposal = propose("rover", [whole])
  if commands == "outputs_0":
    assert "motor_voltage or motor_duty" in proposal.missing[0] and f"log_{commands}.control[3]: " in proposal.text
  else:
    assert f'motor_duty = {{ column = "log_{commands}.control[3]" }}' in proposal.text
    assert f'steering_command = {{ column = "log_{commands}.control[2]"' in proposal.text
  assert ["called as PX4's" in question for question in proposal.questions] == [True]
