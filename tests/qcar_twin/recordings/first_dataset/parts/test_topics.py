"""Several drives of a file per topic: names say which belong together, clocks or motion how they lie."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.parts.joined import joined
from qcar_twin.recordings.first_dataset.parts.topics import drives_and_topics
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError
from scripts import new
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import drive
from tests.qcar_twin.recordings.first_dataset.test_joined import EPOCH, write_topic

TOPICS = ("car_pose", "imu-data", "low_level-cmd", "core")


@pytest.mark.parametrize(
  ("pattern", "drives", "named"),
  [
    ("{drive}_{topic}.csv", ("take1", "take2"), None),
    ("{topic}_{drive}.csv", ("run-3", "run-4"), None),
    ("{drive}/{topic}.csv", ("monday", "later/tuesday"), ("monday", "later_tuesday")),
    ("{drive}_{topic}_0.csv", ("log_7_2023-9-2-10-12-40", "log_8_2023-9-2-11-12-40"), None),
  ],
)
def test_names_say_drive_and_topic(pattern, drives, named):
  files = {
    pattern.format(drive=d, topic=t): (n, t) for d, n in zip(drives, named or drives, strict=True) for t in TOPICS
  }
  split = drives_and_topics(tuple(files))
  assert split is not None
  assert {file: (drive, topic.removesuffix("_0")) for file, (drive, topic) in split.items()} == files


@pytest.mark.parametrize(
  "files",
  [
    ("run1_imu.csv", "run1_core.csv", "run1_cmd.csv"),  # one drive alone
    ("run1_car.csv", "run1_mocap.csv", "run2_car.csv", "run2_mocap.csv"),  # two kinds, which are paired
    ("oval_1.csv", "oval_2.csv", "step_1.csv", "circle_1.csv", "circle_4.csv"),
  ],
)
def test_other_names_say_none(files):
  assert drives_and_topics(files) is None


def write_take(folder, number, device=None, pattern="take{}_{}.csv", steered=1.0, late=0.0, felt=True):
  """A drive as three files; `device`: what the IMU's own clock is ahead of the others', s, where it has one; `late`:
  what steering acts late, s; `felt`: whether the IMU has accelerometers."""
  time, own = wander(number, seconds=40.0)
  start = EPOCH + 100.0 * number
  steering = np.interp(time + late, time, own["steering_command"])
  imu = {"gyro_z": own["yaw_rate"]} | ({"acc_x": own["accel_x"], "acc_y": own["accel_y"]} if felt else {})
  command = {"throttle": own["motor_voltage"] / 12.0, "steer_us": 1500.0 + 900.0 * steered * steering}
  content = {
    "cmd": ("stamp", start + time[::2], {k: v[::2] for k, v in command.items()}),
    "imu": (
      ("stamp", start + time + 0.003, imu) if device is None else ("millis", 1e3 * (start + time - EPOCH + device), imu)
    ),
    "wheel": ("stamp", start + time[::4], {"speed": own["speed"][::4]}),
  }
  for topic, (clock, stamps, columns) in content.items():
    path = folder / pattern.format(number, topic)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_topic(path, clock, stamps, columns)
  return own


def test_each_take_of_a_flat_folder_becomes_a_recording(tmp_path, capsys):
  own = {number: write_take(tmp_path / "logs", number) for number in (1, 2, 3)}
  new.main(new.Config(tmp_path / "lab", (tmp_path / "logs",), wheelbase=0.256, mass=2.7))
  said = capsys.readouterr().out
  assert "take2_cmd.csv, take2_imu.csv, take2_wheel.csv: parts of one drive by their names" in said
  data = DataSet.load(tmp_path / "lab")
  assert [run.name for run in data.recordings] == [f"take{k}_joined" for k in (1, 2, 3)]
  for number, run in enumerate(data.recordings, 1):
    assert {"motor_duty", "steering_command", "speed", "yaw_rate"} <= set(run.channels)
    assert np.isin(np.round(run["yaw_rate"].value, 9), np.round(own[number]["yaw_rate"], 9)).all()


@pytest.mark.parametrize("pattern", ["take{}_{}.csv", "run{}/{}.csv"])
def test_a_device_with_a_clock_of_its_own_is_joined_by_what_both_felt(tmp_path, pattern):
  for number in (1, 2):
    write_take(tmp_path, number, device=7.25 * number, pattern=pattern)
  files = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.csv"))
  drives = joined([read_table(tmp_path / file, file) for file in files])
  assert len(drives.made) == 2 and "their motion" in drives.said[0]
  for number, table in enumerate(drives.made, 1):
    time = table.columns["time"][np.isfinite(table.columns["imu.gyro_z"])]
    assert time[0] == pytest.approx(EPOCH + 100.0 * number, abs=0.03)


@pytest.mark.parametrize("felt", [True, False])
def test_what_both_felt_tells_the_clock_where_the_car_lags_behind_its_commands(tmp_path, felt):
  """Steering acts 0.2 s late; a wheel's speeding up, which an accelerometer feels, does not."""
  for number in (1, 2):
    write_take(tmp_path, number, device=5.0, late=0.2, felt=felt)
  drives = joined([read_table(file, file.name) for file in sorted(tmp_path.glob("*.csv"))])
  time = drives.made[0].columns["time"][np.isfinite(drives.made[0].columns["imu.gyro_z"])]
  assert time[0] - EPOCH - 100.0 == pytest.approx(0.0 if felt else -0.2, abs=0.04)
  assert ("what the car takes to obey" in drives.said[0]) == (not felt)


@pytest.mark.parametrize(
  ("device", "steered", "said"),
  [
    (7.0, 0.0, r"take1_imu.csv: are of one drive.*the motion never.*leave it out"),
    (None, 1.0, r"take2_cmd.csv and take2_wheel.csv: are of one drive.*hardly meet"),
  ],
  ids=["no motion tells", "never meet"],
)
def test_files_of_one_drive_whose_clocks_cannot_be_joined_are_refused_by_name(tmp_path, device, steered, said):
  for number in (1, 2):
    write_take(tmp_path, number, device=device, steered=steered)
  if device is None:
    (tmp_path / "take2_wheel.csv").write_bytes((tmp_path / "take1_wheel.csv").read_bytes())
  tables = [read_table(file, file.name) for file in sorted(tmp_path.glob("*.csv"))]
  with pytest.raises(RecordingError, match=said):
    joined(tables)


def test_a_file_without_a_clock_is_said(tmp_path):
  for number in (1, 2):
    write_take(tmp_path, number)
    (tmp_path / f"take{number}_gains.csv").write_text("kp,kd\n1,2\n3,1\n", encoding="utf-8")
  drives = joined([read_table(file, file.name) for file in sorted(tmp_path.glob("*.csv"))])
  assert "take1_gains.csv: left out, no column is a clock" in drives.said and len(drives.made) == 2


def test_drives_that_each_have_command_and_answer_stay_drives(tmp_path):
  time, own = drive(12.0)
  for car in ("blue", "red"):
    for course in ("oval", "eight", "snake"):
      write_topic(tmp_path / f"{car}_{course}.csv", "time", time, own)
  files = sorted(tmp_path.glob("*.csv"))
  assert drives_and_topics([file.name for file in files]) is not None
  assert not joined([read_table(file, file.name) for file in files]).made
