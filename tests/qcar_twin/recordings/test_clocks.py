"""Clocks that are none, steps, dates, out of order or late; files whose columns have no names."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from tests.qcar_twin.recordings.drives import drive, folder_with, write_csv, write_manifest
from tests.qcar_twin.recordings.loading import refused

EPOCH = 1759663727.0
CHANNELS = "\n".join(f'{name} = {{ column = "{name}" }}' for name in drive()[1])


def same(run, time, columns, within=1e-6):
  assert run["yaw_rate"].time == pytest.approx(time, abs=within)
  assert (run["yaw_rate"].value == columns["yaw_rate"]).all()


def test_a_fixed_rate_is_a_clock(tmp_path):
  time, columns = drive()
  folder = folder_with(tmp_path, time, columns, channels="time = { rate = 100.0 }\n" + CHANNELS)
  text = (folder / "run.csv").read_text().splitlines()
  (folder / "run.csv").write_text("\n".join(line.split(",", 1)[1] for line in text) + "\n")
  same(DataSet.load(folder).recordings[0], time, columns)
  write_manifest(folder, channels="time = { rate = 0.0 }")
  refused(folder, "needs a positive rate in Hz")


def test_steps_add_up_to_a_clock(tmp_path):
  time, columns = drive()
  folder = folder_with(
    tmp_path,
    np.diff(time, prepend=-0.01) * 1e9,
    columns,
    channels='time = { column = "time", scale = 1e-9, steps = true }\n' + CHANNELS,
  )
  same(DataSet.load(folder).recordings[0], time, columns)


def test_rows_out_of_order_are_sorted_where_it_is_asked_for(tmp_path):
  time, columns = drive()
  order = np.arange(time.size)
  order[[40, 41]] = order[[41, 40]]
  shuffled = {name: values[order] for name, values in columns.items()}
  folder = folder_with(tmp_path, time[order], shuffled)
  refused(folder, "time goes backwards in row 42", "set sort = true on time")
  write_manifest(folder, channels='time = { column = "time", sort = true }\n' + CHANNELS)
  data = DataSet.load(folder)
  same(data.recordings[0], time, columns)
  assert data.warnings == ("run.csv: 1 of 1200 rows are out of order, first row 42; sorted by time",)


@pytest.mark.parametrize("sort", [False, True])
def test_a_clock_that_was_set_back_is_none_of_rows_out_of_order(tmp_path, sort):
  """Sorted, the rows of two times would alternate. Stamps of the new time fall between those of the old."""
  time, columns = drive()
  time[600:] -= 0.075
  time_line = f'time = {{ column = "time", sort = {str(sort).lower()} }}\n'
  folder = folder_with(tmp_path, time, columns)
  write_manifest(folder, channels=time_line + CHANNELS)
  refused(folder, "the clock was set back by 0.065 s; split the file before row 601")


def test_messages_that_were_written_late_together_are_sorted(tmp_path):
  """One sensor's messages, which came in late as a block, leave a gap of their own among the others' rows."""
  time, columns = drive()
  own = np.zeros(time.size, dtype=bool)
  own[1::2] = True
  for name, values in columns.items():
    columns[name] = np.where(own == (name == "motor_speed"), values, np.nan)
  late = np.arange(601, 621, 2)
  order = np.r_[np.setdiff1d(np.arange(640), late), late, np.arange(640, time.size)]
  folder = folder_with(tmp_path, time[order], {name: values[order] for name, values in columns.items()})
  write_manifest(folder, channels='time = { column = "time", sort = true }\n' + CHANNELS)
  (run,) = DataSet.load(folder).recordings
  assert run["motor_speed"].time == pytest.approx(time[own])


@pytest.mark.parametrize("sort", [False, True])
@pytest.mark.parametrize(("unset", "said"), [([0, 1, 2], "in row 1 and 2 more rows"), ([700], "in row 701 and a date")])
def test_a_stamp_of_zero_among_dates_is_named(tmp_path, unset, said, sort):
  time, columns = drive()
  time = time + EPOCH
  time[unset] = 0.0
  folder = folder_with(tmp_path, time, columns)
  write_manifest(folder, channels=f'time = {{ column = "time", sort = {str(sort).lower()} }}\n' + CHANNELS)
  refused(folder, f"time is 0 {said}", "the clock was not set there; delete")


def test_a_part_of_a_log_whose_clock_was_put_right_by_days(tmp_path):
  """What `new` writes counts from the file's start, be it more than the seconds from which a stamp is a date."""
  time, columns = drive()
  stamp = EPOCH + np.where(time < 5.0, time, time + 1.2e6)
  data = DataSet.load(folder_with(tmp_path, stamp, columns, extra="from = 1200006.0"))
  assert data.recordings[0].start == pytest.approx(1200006.0)


def test_a_stamp_of_the_day_is_counted_from_the_files_start_and_kept(tmp_path):
  time, columns = drive()
  shifted = np.where(time < 5.0, time, time + 3.0) + EPOCH
  data = DataSet.load(folder_with(tmp_path, shifted, columns, extra="from = 1.0"))
  assert [r.origin[0] for r in data.recordings] == [EPOCH, EPOCH] and data.recordings[0].start == pytest.approx(1.0)
  assert data.warnings[0] == (
    "run.csv: nothing was logged from 4.99 s to 8 s after the file's start (1759663727.000); the recording is cut there"
  )
  dated = DataSet.load(folder_with(tmp_path, shifted, columns, extra=f"from = {EPOCH + 1.0}"))
  assert dated.recordings[0].start == pytest.approx(1.0)


def test_under_a_stamp_of_the_day_commands_act_in_the_same_periods(tmp_path):
  """Doubles are 2.4e-7 s apart there: a row that is late by half of that is no row of the next period."""
  time, columns = drive()
  before = DataSet.load(folder_with(tmp_path, time, columns)).recordings[0]
  after = DataSet.load(folder_with(tmp_path, time + EPOCH, columns)).recordings[0]
  assert np.array_equal(after["yaw_rate"].time, time)
  for one, other in zip(before.commands(0.01), after.commands(0.01), strict=True):
    assert np.array_equal(one, other)


def test_places_of_a_map_are_counted_from_nearby(tmp_path):
  time, columns = drive()
  far = columns | {"pose_x": columns["pose_x"] + 5e5, "pose_y": columns["pose_y"] + 5.4e6}
  run = DataSet.load(folder_with(tmp_path, time, far)).recordings[0]
  assert run.origin == (0.0, 5e5, 5.4e6)
  assert run["pose_y"].value == pytest.approx(columns["pose_y"], abs=1e-8)


def test_a_late_channel_is_moved_back(tmp_path):
  time, columns = drive()
  late = CHANNELS.replace('{ column = "yaw_rate" }', '{ column = "yaw_rate", late = 0.25 }')
  run = DataSet.load(folder_with(tmp_path, time, columns, channels='time = { column = "time" }\n' + late)).recordings[0]
  assert run["yaw_rate"].time == pytest.approx(time - 0.25) and (run["accel_x"].time == time).all()


def test_only_a_clock_has_a_rate_or_steps(tmp_path):
  time, columns = drive()
  folder = folder_with(tmp_path, time, columns, channels='yaw_rate = { column = "yaw_rate", steps = true }')
  refused(folder, "[channels] yaw_rate cannot have steps, which belongs to time")


def test_columns_without_a_header_are_named_in_the_data_set(tmp_path):
  time, columns = drive()
  folder = folder_with(tmp_path, time, columns)
  header, *rows = (folder / "run.csv").read_text().splitlines()
  (folder / "run.csv").write_text("\n".join(rows) + "\n")
  refused(folder, "the first line holds numbers, not column names", 'columns = ["time", …]')
  names = ", ".join(f'"{name}"' for name in header.split(","))
  write_manifest(folder, top=f'name = "lab"\ncolumns = [{names}]')
  same(DataSet.load(folder).recordings[0], time, columns)
  write_manifest(folder, top='name = "lab"\ncolumns = ["time", "speed"]')
  refused(folder, "has 10 columns, and columns in dataset.toml names 2")


@pytest.mark.parametrize("head", ["# written by a logger\n# version 2\n", "# "])
def test_comments_above_the_header_and_a_header_that_is_one(tmp_path, head):
  time, columns = drive()
  folder = folder_with(tmp_path, time, columns)
  (folder / "run.csv").write_text(head + (folder / "run.csv").read_text())
  same(DataSet.load(folder).recordings[0], time, columns)


def test_a_driver_by_hand_is_read_with_the_measured_speed_as_command(tmp_path):
  time, columns = drive()
  columns["speed"] = columns.pop("motor_speed") * 0.033 * 0.0953668
  del columns["motor_voltage"]
  data = DataSet.load(folder_with(tmp_path, time, columns))
  run = data.recordings[0]
  assert run.drive_channel == "speed_command" and (run["speed_command"].value == run["speed"].value).all()
  said = "no column is mapped to a command of the drive; the measured speed stands for it"
  assert any(said in note for note in data.warnings)
  write_csv(tmp_path / "run.csv", time, {name: columns[name] for name in ("speed", "yaw_rate")})
  refused(tmp_path, "needed channel 'motor_voltage' is missing")
