"""A folder of tables, one per topic, is read as a bag is."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.place import logs_of
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError

BEGIN = 1_700_000_000_000_000_000  # ns


def write(path, header, *rows):
  path.parent.mkdir(exist_ok=True)
  path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n", encoding="utf-8")


def run(folder):
  """Two topics that call their column `data`, at 50 and 100 Hz, and one with a quaternion."""
  every = lambda ms, count: [BEGIN + ms * 1_000_000 * k for k in range(count)]
  write(folder / "servo.csv", "timestamp_ns,data", *((t, 0.5) for t in every(20, 5)))
  write(folder / "duty.csv", "timestamp_ns,data", *((t + 5_000_000, 0.1) for t in every(10, 10)))
  half = np.sqrt(0.5)
  turned = [(t, 0.0, 0.0, half, half) for t in every(20, 5)]
  write(folder / "pose.csv", "timestamp_ns,orientation.x,orientation.y,orientation.z,orientation.w", *turned)
  return folder


def test_rows_are_the_stamps_of_all_and_a_topic_without_a_sample_is_blank(tmp_path):
  table = read_table(run(tmp_path / "run1"))
  assert {"time", "servo.data", "duty.data", "pose.orientation.yaw"} <= set(table.columns)
  assert table.label == "run1" and table.rows == 15 and table.notes == ()
  np.testing.assert_allclose(np.diff(table.columns["time"])[:3], [0.005, 0.010, 0.005], atol=1e-6)
  assert table.columns["time"][0] == pytest.approx(1.7e9)
  assert np.isfinite(table.columns["servo.data"]).sum() == 5 and np.isfinite(table.columns["duty.data"]).sum() == 10
  yaw = table.columns["pose.orientation.yaw"]
  np.testing.assert_allclose(yaw[np.isfinite(yaw)], 0.5 * np.pi)


def test_the_stamp_of_a_messages_header_comes_before_the_time_it_was_received(tmp_path):
  rows = [(10.0 + 0.01 * k + 0.004, 10, 10_000_000 * k, 0.1 * k) for k in range(5)]
  write(tmp_path / "run" / "imu.csv", "time,header.stamp.sec,header.stamp.nanosec,rate", *rows)
  write(tmp_path / "run" / "cmd.csv", "time,data", *((10.0 + 0.01 * k, 1.0) for k in range(5)))
  table = read_table(tmp_path / "run")
  assert table.rows == 5 and np.isfinite(table.columns["imu.rate"]).all()
  assert set(table.columns) >= {"imu.rate", "cmd.data"} and "imu.header.stamp.sec" not in table.columns


def test_messages_out_of_order_are_sorted_by_their_stamps(tmp_path):
  order = [*range(60), 61, 60, *range(62, 200)]
  write(tmp_path / "run" / "imu.csv", "stamp,rate", *((0.01 * k, k) for k in order))
  write(tmp_path / "run" / "cmd.csv", "stamp,data", *((0.01 * k, 1) for k in range(200)))
  table = read_table(tmp_path / "run")
  np.testing.assert_array_equal(table.columns["imu.rate"], np.arange(200.0))


@pytest.mark.parametrize(("unit", "began"), [(1.0, 0.0), (1e6, 93e6)])
def test_a_slow_topics_clock_is_in_the_unit_of_the_others(tmp_path, unit, began):
  """By its steps alone one a second would be in ms, and one of a million microseconds in ns."""
  write(tmp_path / "run" / "imu.csv", "timestamp,rate", *((began + unit * 0.01 * k, k) for k in range(3000)))
  write(tmp_path / "run" / "battery.csv", "timestamp,volt", *((began + unit * k, 12.0) for k in range(30)))
  table = read_table(tmp_path / "run")
  stamps = table.columns["time"][np.isfinite(table.columns["battery.volt"])]
  np.testing.assert_allclose(stamps - table.columns["time"][0], np.arange(30.0), atol=1e-6)


def test_what_has_no_clock_is_left_out_with_a_note_and_a_silent_topic_without(tmp_path):
  folder = run(tmp_path / "run1")
  write(folder / "sizes.csv", "name,value", ("wheelbase", 0.25), ("mass", 2.0))
  write(folder / "horn.csv", "timestamp_ns,data")
  (folder / "notes.txt").write_text("it rained\n", encoding="utf-8")
  table = read_table(folder)
  assert [note.partition(":")[0] for note in table.notes] == ["run1/sizes.csv"] and table.rows == 15
  assert not any(name.startswith(("sizes", "horn", "notes")) for name in table.columns)


def test_clocks_without_a_time_in_common_are_refused_by_name(tmp_path):
  folder = run(tmp_path / "run1")
  write(folder / "imu.csv", "time,rate", *((0.01 * k, 1.0) for k in range(20)))
  with pytest.raises(RecordingError, match=r"run1/imu.csv ends at 0.19 s and run1/duty.csv begins at 1.7.*same clock"):
    read_table(folder)


def test_a_folder_in_which_no_table_has_a_clock_is_refused_with_the_cure(tmp_path):
  write(tmp_path / "run" / "a.csv", "x,y", (1, 2), (2, 3))
  with pytest.raises(RecordingError, match="run: no table in this folder has a clock by its name; name the column"):
    read_table(tmp_path / "run")


def test_a_bags_description_beside_its_tables_makes_no_bag(tmp_path):
  run(tmp_path / "bag1")
  (tmp_path / "bag1" / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n")
  assert len(logs_of([tmp_path / "bag1"])) == 3 and read_table(tmp_path / "bag1").rows == 15
  (tmp_path / "bag1" / "bag1_0.mcap").write_bytes(b"")
  with pytest.raises(RecordingError, match="bag1"):
    read_table(tmp_path / "bag1")


def test_mcap_files_without_a_description_are_logs_of_their_own(tmp_path):
  for name in ("a.mcap", "b.mcap"):
    (tmp_path / name).write_bytes(b"x")
  assert logs_of([tmp_path]) == [tmp_path / "a.mcap", tmp_path / "b.mcap"]


def test_a_damaged_topic_is_named(tmp_path):
  folder = run(tmp_path / "run1")
  (folder / "imu.csv").write_text("timestamp_ns,rate\n1,2\n2,3,4\n", encoding="utf-8")
  with pytest.raises(RecordingError, match="run1/imu.csv: a row does not fit the header"):
    read_table(folder)


def test_a_blank_cell_is_none_of_the_file_that_says_nan(tmp_path):
  rows = [(0.01 * k, k, "" if k % 5 else 1, "NaN" if k == 7 else 2) for k in range(40)]
  write(tmp_path / "run" / "cmd.csv", "time,data,now_and_then,limit", *rows)
  write(tmp_path / "run" / "cmd.tsv", "time\tdata\n0.0\t1\n0.2\t2")
  table = read_table(tmp_path / "run")
  assert {"cmd.csv.data", "cmd.tsv.data"} <= set(table.columns)
  assert {name: rows.tolist() for name, rows in table.not_a_number.items() if rows.size} == {"cmd.csv.limit": [7]}
