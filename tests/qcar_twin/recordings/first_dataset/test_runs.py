"""When a folder is one recording of a table per topic, and when it holds recordings."""

import tomllib

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.parts.runs import is_one_recording
from qcar_twin.recordings.first_dataset.place import logs_of
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.vehicle.vehicle import QCAR
from scripts import new
from tests.qcar_twin.recordings.drives import drive, write_csv

EPOCH = 1.7e9


def write_run(folder, seed=0, start=EPOCH):
  """What a VESC, a servo, an IMU and motion capture say of one drive, a topic a file; the VESC repeats the duty."""
  folder.mkdir(parents=True)
  time, own = drive(30.0, seed=seed)
  duty, halves, volts = own["motor_voltage"] / 12.0, 0.5 * own["pose_yaw"], 12.0 - 0.1 * own["motor_voltage"]
  erpm = own["motor_speed"] * 60.0 / np.pi  # of 2 pole pairs
  flat = {"orientation.x": 0.0 * time, "orientation.y": 0.0 * time}
  turn = lambda yaw: {**flat, "orientation.z": np.sin(yaw), "orientation.w": np.cos(yaw)}
  topics = {
    "commands_motor_duty_cycle": ({"data": duty}, 2, 0.0),
    "servo_position": ({"data": 0.5 - 0.9 * own["steering_command"]}, 2, 0.001),
    "sensors_core": ({"speed": erpm, "duty_cycle": duty, "voltage_input": volts}, 2, 0.004),
    "imu": ({"angular_velocity.z": own["yaw_rate"], **turn(0.0 * halves + 1.0)}, 1, 0.002),
    "mocap": ({"position.x": own["pose_x"], "position.y": own["pose_y"], **turn(halves)}, 1, 0.003),
  }  # fmt: skip
  for name, (columns, every, late) in topics.items():
    write_csv(folder / f"{name}.csv", start + time[::every] + late, {k: v[::every] for k, v in columns.items()})
  return folder


def test_runs_of_a_table_per_topic_are_recordings_of_their_own(tmp_path, capsys):
  for number in (1, 2, 3):
    write_run(tmp_path / "logs" / f"run{number}", number, EPOCH + 100.0 * number)
  new.main(new.Config(tmp_path / "lab", (tmp_path / "logs",), wheelbase=0.256, mass=2.7))
  assert (
    "3 logs" in (said := capsys.readouterr().out) and "counts electrical" not in said
  )  # the place tells the gearing
  text = (tmp_path / "lab" / "dataset.toml").read_text(encoding="utf-8")
  for channel, column in {
    "motor_duty": "commands_motor_duty_cycle.data", "steering_command": "servo_position.data",
    "motor_speed": "sensors_core.speed", "yaw_rate": "imu.angular_velocity.z", "pose_yaw": "mocap.orientation.yaw",
  }.items():  # fmt: skip
    assert f'\n{channel} = {{ column = "{column}"' in text
  assert tomllib.loads(text)["vehicle"]["gear_ratio"] == pytest.approx(QCAR.gear_ratio, rel=0.01)
  data = DataSet.load(tmp_path / "lab")
  assert [(run.name, run.file) for run in data.recordings] == [(f"run{k}", f"run{k}") for k in (1, 2, 3)]
  time, own = drive(30.0, seed=2)
  read = data["run2"]["yaw_rate"]
  assert read.time[0] == pytest.approx(0.002, abs=1e-6)
  np.testing.assert_allclose(read.value, own["yaw_rate"])


def test_electrical_revolutions_are_asked_about_where_nothing_tells_the_gearing(tmp_path):
  (write_run(tmp_path / "logs" / "run1") / "mocap.csv").unlink()
  with pytest.raises(RecordingError, match="not decided yet: 'sensors_core.speed' counts electrical"):
    new.main(new.Config(tmp_path / "lab", (tmp_path / "logs",), wheelbase=0.256, mass=2.7))


@pytest.mark.parametrize("start", [EPOCH, 0.0])
def test_a_run_by_itself_is_one_recording_where_its_clock_is_a_dates(tmp_path, start):
  """Both topics of commands call their column `data`, as two drives that were logged alike do."""
  folder = write_run(tmp_path / "logs" / "run1", start=start)
  assert is_one_recording(folder) is (start > 0.0)
  assert logs_of((folder,)) == ([folder] if start else sorted(folder.iterdir()))
  assert logs_of((folder,), folder) == sorted(folder.iterdir())


def test_topics_on_a_clock_from_zero_are_told_by_the_next_runs_names(tmp_path):
  runs = [write_run(tmp_path / f"run{number}", number, 0.0) for number in (1, 2)]
  assert logs_of((tmp_path,)) == runs
  (runs[1] / "imu.csv").rename(runs[1] / "gyro.csv")
  assert not is_one_recording(runs[0])


@pytest.mark.parametrize("start", [0.0, EPOCH])
def test_drives_that_were_logged_alike_are_recordings_of_their_own(tmp_path, start):
  time, own = drive(12.0)
  columns = {name: own[name] for name in ("motor_voltage", "motor_speed", "yaw_rate")}
  for day in ("monday", "tuesday"):
    (tmp_path / day).mkdir()
    for number in range(4):
      write_csv(tmp_path / day / f"run{number}.csv", start + (50.0 * number if start else 0.0) + time, columns)
  assert not is_one_recording(tmp_path / "monday")
  assert len(logs_of((tmp_path,))) == 8


def test_a_drives_log_beside_its_motion_capture_and_tables_without_a_clock_are_none(tmp_path):
  folder = write_run(tmp_path / "run1")
  for name in ("servo_position", "imu", "sensors_core"):
    (folder / f"{name}.csv").unlink()
  assert not is_one_recording(folder)  # two files: by clock or motion they are joined
  for name in ("laps", "sizes", "tyres"):
    (tmp_path / f"{name}.csv").write_text("name,value\na,1\nb,2\n", encoding="utf-8")
  assert not is_one_recording(tmp_path)
