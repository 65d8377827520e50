"""Tables of ROS 2 messages without heads, as `ros2 topic echo --csv` writes them."""

import numpy as np
import pytest

from qcar_twin.extras import MissingExtra
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.parts.runs import is_one_recording
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.text import echoed
from qcar_twin.recordings.recording import RecordingError
from tests.faults.wander import wander

BEGAN = 1_733_000_000
ODOM, IMU = [0.0] * 36, [0.0] * 9


def echo(path, fields, step=0.02, frame="base_link", began=BEGAN):
  """Rows of a stamp, a frame and `fields`, a list of cells each."""
  stamps = [divmod(round(1e9 * step) * k, 10**9) for k in range(len(fields))]
  rows = [[began + s, ns, frame, *cells] for (s, ns), cells in zip(stamps, fields, strict=True)]
  path.parent.mkdir(exist_ok=True)
  path.write_text("".join(",".join(map(str, row)) + "\n" for row in rows), encoding="utf-8")
  return path


def odometry(x, speed, yaw, rate):
  turned = [0.0, 0.0, float(np.sin(0.5 * yaw)), float(np.cos(0.5 * yaw))]
  return ["base_link", x, 0.0, 0.0, *turned, *ODOM, speed, 0.0, 0.0, 0.0, 0.0, rate, *ODOM]


def drive(k):
  return [0.01 * k, 0, 1.0 + 0.1 * k, 0.0, 0.0]


def test_a_messages_columns_are_called_as_a_bags(tmp_path):
  path = echo(tmp_path / "log.csv", [odometry(0.1 * k, 2.0, 0.02 * k, 1.0) for k in range(30)], frame="odom")
  table = read_table(path)
  assert not table.headless and table.columns["pose.pose.position.x"][3] == pytest.approx(0.3)
  assert table.columns["twist.twist.linear.x"].tolist() == [2.0] * 30 and "pose.covariance[35]" in table
  assert table.columns["pose.pose.orientation.yaw"] == pytest.approx(0.02 * np.arange(30))
  assert np.diff(table.columns["header.stamp"]) == pytest.approx(np.full(29, 0.02), abs=1e-6)


def test_a_frame_without_a_name_is_a_text_all_the_same(tmp_path):
  cells = [[0.0, 0.0, 0.0, 1.0, *IMU, 0.0, 0.0, 0.1 * k, *IMU, 0.1, 0.2, 9.8, *IMU] for k in range(30)]
  table = read_table(echo(tmp_path / "log.csv", cells, frame=""))
  assert table.columns["angular_velocity.z"][2] == pytest.approx(0.2)
  assert table.columns["linear_acceleration.z"][2] == 9.8


def test_of_messages_that_look_alike_the_files_name_tells(tmp_path):
  cells = [[1, 0.5, 0.02, 4.0, 1.0 + 0.01 * k] for k in range(30)]  # a range, or a command
  assert "range" in read_table(echo(tmp_path / "range_front.csv", cells))
  assert "drive.jerk" in read_table(echo(tmp_path / "ackermann_cmd.csv", cells))
  assert read_table(echo(tmp_path / "log.csv", cells)).headless
  assert "drive.speed" in read_table(echo(tmp_path / "any.csv", [drive(k) for k in range(30)]))  # no kind is 0.01


@pytest.mark.parametrize(
  "began, cells",
  [(BEGAN, [0.1, 0.2]), (-5, drive(1)), (BEGAN, ["left", 0, 1.0, 0.0, 0.0]), (0.5, drive(1))],
  ids=["no message", "before any time", "a text for a number", "no whole seconds"],
)
def test_columns_of_no_message_stay_without_names(tmp_path, began, cells):
  table = read_table(echo(tmp_path / "drive.csv", [cells for _ in range(30)], began=began))
  assert table.headless and list(table.columns)[:2] == ["column_1", "column_2"]


@pytest.mark.parametrize("second", [0, 1_500_000_000], ids=["stands", "beyond its second"])
def test_what_is_no_stamp_makes_no_message(tmp_path, second):
  rows = [f"{BEGAN},{second},base_link," + ",".join(map(str, drive(k))) for k in range(30)]
  (tmp_path / "drive.csv").write_text("\n".join(rows), encoding="utf-8")
  assert read_table(tmp_path / "drive.csv").headless


def test_names_that_a_data_set_gives_go_before(tmp_path):
  table = read_table(echo(tmp_path / "drive.csv", [drive(k) for k in range(30)]))
  names = ["s", "ns", "frame", "angle", "b", "speed", "d", "e"]
  assert list(table.named(names).columns) == names and table.named(names).columns["speed"][1] == 1.1
  assert table.named(()) is table
  with pytest.raises(RecordingError, match="has 8 columns, and columns in dataset.toml names 2"):
    table.named(["a", "b"])


def test_without_rosbags_such_tables_have_no_names(tmp_path, monkeypatch):
  class Absent:
    def __enter__(self):
      raise MissingExtra("not installed")

    def __exit__(self, *_):
      return False

  monkeypatch.setattr(echoed, "extra", lambda _: Absent())
  echoed._layouts.cache_clear()
  assert read_table(echo(tmp_path / "drive.csv", [drive(k) for k in range(30)])).headless
  monkeypatch.undo()
  echoed._layouts.cache_clear()


def test_a_folder_of_such_tables_is_one_drive(tmp_path):
  for name, seed in (("run1", 51), ("run2", 52)):
    time, logged = wander(seed)
    step = float(time[1] - time[0])
    columns = [logged[channel].tolist() for channel in ("steering_command", "speed", "yaw_rate", "pose_yaw")]
    rows, felt = list(zip(*columns, strict=True)), np.random.default_rng(seed).normal(0.0, 0.1, (time.size, 2)).tolist()
    echo(tmp_path / name / "drive.csv", [[angle, 0, v, 0.0, 0.0] for angle, v, _, _ in rows], step)
    echo(tmp_path / name / "odom.csv", [odometry(0.0, v, yaw, rate) for _, v, rate, yaw in rows], step, "odom")
    imu = [
      [0.0, 0.0, 0.0, 1.0, *IMU, 0.0, 0.0, rate, *IMU, *forces, 9.8, *IMU]
      for (*_, rate, _), forces in zip(rows, felt, strict=True)
    ]
    echo(tmp_path / name / "imu.csv", imu, step)
  assert is_one_recording(tmp_path / "run1")
  tables = [read_table(tmp_path / name, name) for name in ("run1", "run2")]
  (tmp_path / "dataset.toml").write_text(propose("car", tables, wheelbase=0.256, mass=2.7).text, encoding="utf-8")
  runs = DataSet.load(tmp_path).recordings
  assert {run.file for run in runs} == {"run1", "run2"}
  assert all({"speed_command", "steering_command", "speed", "yaw_rate"} <= set(run.channels) for run in runs)
