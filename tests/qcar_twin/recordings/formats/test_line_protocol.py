"""InfluxDB's line protocol."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.place import logs_of, placed, with_rows
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.table import NoSamples, SeveralRecordings
from qcar_twin.recordings.recording import RecordingError

BEGAN = 1719820800 * 10**9  # ns
STEP = 20 * 10**6


def write(path, lines, end="\n"):
  path.write_text("\n".join(lines) + end, encoding="utf-8")
  return path


def column(table, name):
  """Times from the first, s, and values of a column where it has samples."""
  there = np.isfinite(table.columns[name])
  return table.columns["time"][there] - table.columns["time"][0], table.columns[name][there]


def drive(run, began, count=30):
  lines = []
  for k in range(count):
    stamp = began + k * STEP
    lines.append(f"imu,car=a,run={run} acc_x={0.5 * k},gyro_z=-1e-1 {stamp}")
    lines.append(f"motor,car=a,run={run} rpm={k}i {stamp + 5 * 10**6}")
  return lines


def test_each_measurement_keeps_its_own_stamps(tmp_path):
  lines = ["# DDL", "CREATE DATABASE garage WITH NAME autogen", "# DML", "", *drive("01", BEGAN)]
  lines += [f'battery,car=a voltage=11.5,ok=true,low=F,cells=3u,mode="a, b\\" c=1" {BEGAN}']
  lines += [f"battery,car=a voltage=11.4,ok=FALSE {BEGAN + STEP}"]
  (log,) = logs_of([write(tmp_path / "export.lp", lines).parent])
  table = read_table(log)
  assert set(table.columns) == {
    "time", "imu.acc_x", "imu.gyro_z", "motor.rpm", "battery.voltage", "battery.ok", "battery.low", "battery.cells",
  }  # fmt: skip
  time, rpm = column(table, "motor.rpm")
  np.testing.assert_allclose(time, 0.005 + 0.02 * np.arange(30), atol=1e-6)
  np.testing.assert_array_equal(rpm, np.arange(30))
  assert column(table, "imu.gyro_z")[1][0] == -0.1 and column(table, "battery.ok")[1].tolist() == [1.0, 0.0]
  assert column(table, "battery.low")[1].tolist() == [0.0]
  assert table.columns["time"][0] == pytest.approx(1719820800.0, abs=1e-6)
  assert table.notes == ("export.lp: 'battery.mode' holds texts; left out",)


def test_names_are_read_without_their_marks(tmp_path):
  lines = [rf"my\ imu\,left,tag\ a=b\=c,place=front\ axle acc\ x\,y={k} {BEGAN + k * STEP}" for k in range(30)]
  assert set(read_table(write(tmp_path / "a.lp", lines)).columns) == {"time", "my imu,left.acc x,y"}


@pytest.mark.parametrize("digits", [9, 6, 3])
def test_stamps_tell_their_precision_by_their_size(tmp_path, digits):
  lines = [f"imu a={k} {(BEGAN + k * STEP) // 10 ** (9 - digits)}" for k in range(30)]
  time, _ = column(read_table(write(tmp_path / "a.lp", lines)), "imu.a")
  np.testing.assert_allclose(time, 0.02 * np.arange(30), atol=1e-6)


@pytest.mark.parametrize(("step", "seconds"), [(20_000_000, 0.02), (20_000, 0.02), (20, 0.02)])
def test_and_where_they_are_no_dates_by_their_steps(tmp_path, step, seconds):
  table = read_table(write(tmp_path / "a.lp", [f"imu a={k} {k * step}" for k in range(30)]))
  np.testing.assert_allclose(table.columns["time"], seconds * np.arange(30), atol=1e-9)


def test_a_line_for_each_field_and_a_point_written_twice_are_one_column_each(tmp_path):
  lines = [f"imu,car=a {name}={k} {BEGAN + k * STEP}" for name in ("acc_x", "gyro_z") for k in range(30)]
  table = read_table(write(tmp_path / "a.lp", [*lines, *lines]))
  assert table.rows == 30 and set(table.columns) == {"time", "imu.acc_x", "imu.gyro_z"} and not table.notes


def test_a_tag_whose_values_follow_one_another_tells_drives(tmp_path, capsys):
  later = BEGAN + 100 * STEP
  lines = [*drive("02", later), *drive("01", BEGAN), f"gps lat=1 {later + STEP}", f"gps lat=2 {BEGAN + 50 * STEP}"]
  path = write(tmp_path / "a.lp", lines)
  with pytest.raises(SeveralRecordings, match=r"a.lp: holds 2 recordings \(run_01, run_02\)") as several:
    read_table(path)
  first, second = several.value.tables.values()
  assert "gps.lat" not in first and column(second, "gps.lat")[1].tolist() == [1.0]
  np.testing.assert_array_equal(column(first, "motor.rpm")[1], np.arange(30))
  assert first.notes == ("a.lp: 1 points without the tag 'run' are of no time of a drive; left out",)
  read = with_rows(placed(tmp_path, [path]))
  assert [log.name for log, _ in read] == ["a_run_01.csv", "a_run_02.csv"]
  assert first.notes[0] in capsys.readouterr().out


def test_a_tag_whose_values_take_turns_tells_sensors(tmp_path):
  lines = []
  for k in range(30):
    lines += [
      f"imu,at={at},serial={at}7 acc_x={k + shift} {BEGAN + k * STEP}" for at, shift in (("front", 0), ("rear", 9))
    ]
    lines += [f"motor,at=rear rpm={k} {BEGAN + k * STEP}"]
  table = read_table(write(tmp_path / "a.lp", lines))
  assert set(table.columns) == {"time", "imu_front.acc_x", "imu_rear.acc_x", "motor.rpm"}
  np.testing.assert_array_equal(table.columns["imu_rear.acc_x"], 9.0 + np.arange(30))


def test_a_tag_that_tells_a_state_splits_no_column(tmp_path):
  lines = [f"imu,mode={'ab'[k // 20 % 2]} acc_x={k} {BEGAN + k * STEP}" for k in range(80)]
  table = read_table(write(tmp_path / "a.lp", lines))
  np.testing.assert_array_equal(table.columns["imu.acc_x"], np.arange(80))
  assert table.notes == ("a.lp: tag 'mode' of 'imu' changes in mid-file; its values share columns",)


@pytest.mark.parametrize("cut", ["imu acc_x=1", "imu acc", f"imu acc_x=1 {BEGAN // 10**5}"])
def test_a_last_line_that_was_cut_off_is_left_out_with_a_note(tmp_path, cut):
  lines = [f"imu acc_x={k} {BEGAN + k * STEP}" for k in range(30)]
  table = read_table(write(tmp_path / "a.lp", [*lines, cut], end=""))
  assert table.rows == 30 and table.notes == (f"a.lp: the last line is cut off (line 31 ('{cut}')); left out",)


@pytest.mark.parametrize(
  ("line", "said"),
  [
    ("imu acc_x=1", r"a.lp: line 2 \('imu acc_x=1'\) has no stamp, .*; repair or delete that line"),
    ("time,acc_x", "line 2 .* is no point, measurement,tag=value"),
    (f"imu acc_x=1,gyro {BEGAN}", r"line 2 .* has a field that is no number, text or truth value \('gyro'\)"),
    (f"imu acc_x=nan {BEGAN}", r"\('acc_x=nan'\)"),
    (f"imu acc_x=1, {BEGAN}", "line 2 .* has a field that is no number"),
    (f"imu,car acc_x=1 {BEGAN}", "line 2 .* has a tag that is not tag=value"),
    (f"imu,car=a, acc_x=1 {BEGAN}", "line 2 .* has a tag that is not tag=value"),
    (f'imu mode="a {BEGAN}', "line 2 .* is no point"),
    ("imu acc_x=1 9999999999999999999", "line 2 .* has a stamp of more than 64 bits"),
    (f"imu acc_x=1 {BEGAN // 1000}", "line 2 .* has the stamp 1719820800000000, .*; write all stamps in one precision"),
  ],
)
def test_a_bad_line_is_refused_by_its_number(tmp_path, line, said):
  lines = [f"imu acc_x={k} {BEGAN + k * STEP}" for k in range(30)]
  with pytest.raises(RecordingError, match=said):
    read_table(write(tmp_path / "a.lp", [lines[0], line, *lines[1:]]))


def test_what_holds_no_numbers_is_left_out(tmp_path):
  with pytest.raises(NoSamples, match="a.lp: holds no point with a number"):
    read_table(write(tmp_path / "a.lp", ["# DML", f'log text="started" {BEGAN}']))


def test_tags_that_count_points_are_refused(tmp_path):
  lines = [f"imu,n={k} acc_x={k} {BEGAN + k * STEP}" for k in range(300)]
  with pytest.raises(RecordingError, match="a.lp: tag 'n' has 300 values, one after another, .* at most 200 drives"):
    read_table(write(tmp_path / "a.lp", lines))
  again = [f"imu,n={k} acc_x={k} {BEGAN + (k + 300) * STEP}" for k in range(300)]
  with pytest.raises(RecordingError, match="a.lp: tag 'n' of 'imu' tells 300 sensors, .* at most 200"):
    read_table(write(tmp_path / "a.lp", [*lines, *again]))
  tags = ",".join(f"n{k}=1" for k in range(201))
  with pytest.raises(RecordingError, match="a.lp: 'imu' has 201 tags; export it with at most 200"):
    read_table(write(tmp_path / "a.lp", [f"imu,{tags} acc_x={k} {BEGAN + k * STEP}" for k in range(3)]))
  with pytest.raises(RecordingError, match="a.lp: has 10001 fields, and a log has at most 10000"):
    read_table(write(tmp_path / "a.lp", [f"imu f{k}=1 {BEGAN + k * STEP}" for k in range(10001)]))


def test_marks_without_end_take_no_time(tmp_path):
  for text in ("\\" * 100_001, '"' * 100_001, "a b=" + "1" * 100_000 + "e", "a,b=" * 50_000, "a b=1," * 50_000 + "\n"):
    with pytest.raises(RecordingError, match="a.lp: line 1 "):
      read_table(write(tmp_path / "a.lp", [text, "imu a=1 1"]))
