"""Time in logs: values held by slower publishers, gaps."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from tests.qcar_twin.recordings.drives import drive, folder_with
from tests.qcar_twin.recordings.loading import refused

# ---------------------------------------------------------------- hold


def held(value, rows):
  return np.repeat(value[::rows], rows)[: value.size]


def test_hold_keeps_one_sample_per_publication(tmp_path):
  time, columns = drive()
  log = columns | {"yaw_rate": held(columns["yaw_rate"], 10)}
  (run,) = DataSet.load(
    folder_with(tmp_path, time, log, channels='yaw_rate = { column = "yaw_rate", hold = true }')
  ).recordings
  assert (run["yaw_rate"].time == time[::10]).all()
  assert (run["yaw_rate"].value == columns["yaw_rate"][::10]).all()


def test_hold_keeps_sampling_a_true_constant(tmp_path):
  time, columns = drive()
  slow = columns["yaw_rate"].copy()
  slow[300:600] = 0.0  # the car stands for three seconds: the gyro published thirty zeros
  columns["motor_speed"][300:600] = columns["motor_voltage"][300:600] = 0.0
  log = {key: columns[key] for key in columns if not key.startswith("pose")} | {"yaw_rate": held(slow, 10)}
  (run,) = DataSet.load(
    folder_with(tmp_path, time, log, channels='yaw_rate = { column = "yaw_rate", hold = true }')
  ).recordings
  standing = (run["yaw_rate"].time >= 3.0) & (run["yaw_rate"].time < 6.0)
  assert standing.sum() == 30 and not run["yaw_rate"].value[standing].any()
  assert np.diff(run["yaw_rate"].time).max() < 0.11


def test_hold_on_a_channel_that_never_changes_takes_the_rate_of_its_neighbours(tmp_path):
  time, columns = drive()
  log = columns | {"yaw_rate": held(columns["yaw_rate"], 10), "steering_command": np.full(time.size, 0.1)}
  channels = (
    'yaw_rate = { column = "yaw_rate", hold = true }\nsteering_command = { column = "steering_command", hold = true }'
  )
  (run,) = DataSet.load(folder_with(tmp_path, time, log, channels=channels)).recordings
  assert len(run["steering_command"]) == 120 and (run["steering_command"].value == 0.1).all()


def test_hold_on_samples_that_are_not_held_keeps_them_all(tmp_path):
  time, columns = drive(rate=10.0)
  columns["yaw_rate"] = np.round(columns["yaw_rate"], 2)  # chance repeats of a coarse sensor are samples
  (run,) = DataSet.load(
    folder_with(tmp_path, time, columns, channels='yaw_rate = { column = "yaw_rate", hold = true }')
  ).recordings
  assert (run["yaw_rate"].time == time).all()


def test_hold_in_a_short_log_keeps_exactly_the_changes(tmp_path):
  time, columns = drive(0.4)
  log = {"motor_voltage": columns["motor_voltage"], "motor_speed": held(columns["motor_speed"], 10)[:40]}
  folder = folder_with(
    tmp_path,
    time,
    log | {"speed": columns["motor_speed"] * 0.003},
    channels='motor_speed = { column = "motor_speed", hold = true }',
  )
  with pytest.raises(RecordingError, match=r"too few samples \(4\)"):
    DataSet.load(folder)
  log = {
    "motor_voltage": columns["motor_voltage"],
    "motor_speed": columns["motor_speed"],
    "yaw_rate": held(columns["yaw_rate"], 10),
  }
  (run,) = DataSet.load(
    folder_with(tmp_path, time, log, channels='yaw_rate = { column = "yaw_rate", hold = true }')
  ).recordings
  assert (run["yaw_rate"].time == time[::10]).all()


def test_a_lone_held_constant_keeps_its_span(tmp_path):
  time, columns = drive()
  log = {
    "motor_voltage": columns["motor_voltage"],
    "motor_speed": columns["motor_speed"],
    "battery_voltage": np.full(time.size, 8.2),
  }
  channels = 'battery_voltage = { column = "battery_voltage", hold = true }'
  (run,) = DataSet.load(folder_with(tmp_path, time, log, channels=channels)).recordings
  assert run["battery_voltage"].time.tolist() == [time[0], time[-1]]


def slow_and_fast(rows=10):
  """A log whose clock and held columns come from a slower publisher than its pose, as dart's."""
  time, columns = drive()
  log = {key: held(columns[key], rows) for key in ("motor_voltage", "motor_speed", "yaw_rate")}
  log |= {key: columns[key] for key in ("pose_x", "pose_y", "pose_yaw")}
  return time, held(time, rows), columns, log


def test_time_held_by_a_slower_publisher_is_spread_for_the_faster_channels(tmp_path):
  time, stamps, columns, log = slow_and_fast()
  channels = 'motor_speed = { column = "motor_speed", hold = true }\nyaw_rate = { column = "yaw_rate", hold = true }'
  data = DataSet.load(folder_with(tmp_path, stamps, log, channels=channels))
  (run,) = data.recordings
  assert (run["yaw_rate"].time == time[::10]).all() and (run["yaw_rate"].value == columns["yaw_rate"][::10]).all()
  assert len(run["motor_voltage"]) == 120  # not declared held, but it changes only with the stamp
  assert run["pose_x"].time == pytest.approx(time + 0.005, abs=1e-9)
  assert (run["pose_x"].value == columns["pose_x"]).all()
  assert data.warnings == (
    (
      "run.csv: time repeats because a slower publisher holds it; pose_x, pose_y, pose_yaw change in between and are "
      "spread evenly between its stamps"
    ),
  )


def test_repeated_time_with_a_changing_held_column_is_still_an_error(tmp_path):
  _, stamps, _, log = slow_and_fast()
  log["yaw_rate"][25] += 0.1
  channels = 'yaw_rate = { column = "yaw_rate", hold = true }'
  refused(
    folder_with(tmp_path, stamps, log, channels=channels),
    "run.csv: time repeats in row 26",
    "column 'yaw_rate', which has hold = true, changes there",
  )


def messages(coinciding):
  """A log in which every message has a row of its own; of commands and sensors, (stamps, columns), both at some."""
  time, columns = drive()
  sensors = ("motor_speed", "accel_x", "accel_y", "yaw_rate", "pose_x", "pose_y", "pose_yaw")
  late = time + 0.004
  late[coinciding] = time[coinciding]
  stamps = np.r_[time, late]
  order = np.argsort(stamps, kind="stable")
  blank = np.full(time.size, np.nan)
  rows = {name: np.r_[blank, columns[name]] if name in sensors else np.r_[columns[name], blank] for name in columns}
  return stamps[order], {name: values[order] for name, values in rows.items()}, columns


def test_messages_of_one_stamp_in_rows_of_their_own_complete_each_other(tmp_path):
  stamps, log, columns = messages(coinciding=[7, 300])
  data = DataSet.load(folder_with(tmp_path, stamps, log))
  (run,) = data.recordings
  assert (run["motor_voltage"].value == columns["motor_voltage"]).all()
  assert (run["yaw_rate"].value == columns["yaw_rate"]).all()
  assert run["yaw_rate"].time[[6, 7, 8, 300]] == pytest.approx([0.064, 0.07, 0.084, 3.0], abs=1e-9)
  assert not data.warnings


def test_of_two_values_of_one_channel_at_one_stamp_the_first_counts(tmp_path):
  stamps, log, columns = messages(coinciding=[7])
  stamps[16] = stamps[14]  # a second command
  data = DataSet.load(folder_with(tmp_path, stamps, log))
  assert data.recordings[0]["motor_voltage"].value[:8] == pytest.approx(columns["motor_voltage"][:8])
  assert "repeat the time of the row before, first row 16" in data.warnings[0]


def test_stale_rows_before_the_first_stamp_are_cut_off(tmp_path):
  _, stamps, _, log = slow_and_fast()
  stamps = np.where(np.arange(stamps.size) < 10, 0.0, stamps + 200.0)
  data = DataSet.load(folder_with(tmp_path, stamps, log, channels='yaw_rate = { column = "yaw_rate", hold = true }'))
  (run,) = data.recordings
  assert run.name == "run" and run.start == pytest.approx(200.1)
  assert any(
    "the piece from 0 s to 0.095 s has too few samples (1) and is left out" in warning for warning in data.warnings
  )


# ---------------------------------------------------------------- gaps


def test_a_gap_cuts_the_run_and_is_reported(tmp_path):
  time, columns = drive()
  late = np.where(time < 5.0, time, time + 3.0)
  data = DataSet.load(folder_with(tmp_path, late, columns))
  assert [run.name for run in data.recordings] == ["run#1", "run#2"]
  assert [run.file for run in data.recordings] == ["run.csv", "run.csv"]
  assert data.recordings[0].end == pytest.approx(4.99) and data.recordings[1].start == pytest.approx(8.0)
  assert "run.csv: nothing was logged from 4.99 s to 8 s; the recording is cut there" in data.warnings


def test_the_command_in_force_crosses_the_cut(tmp_path):
  time, columns = drive()
  late = np.where(time < 5.0, time, time + 3.0)
  voltage = np.where(np.arange(time.size) == 100, 3.0, np.nan)
  data = DataSet.load(folder_with(tmp_path, late, {"motor_voltage": voltage, "motor_speed": columns["motor_speed"]}))
  assert data["run#2"]["motor_voltage"].time.tolist() == [8.0] and data["run#2"]["motor_voltage"].value.tolist() == [
    3.0
  ]


def test_jitter_and_single_lost_samples_are_no_gaps(tmp_path):
  time, columns = drive(rate=16.0)
  time = time + np.random.default_rng(1).uniform(-0.012, 0.012, time.size)
  keep = np.arange(time.size) % 37 != 5
  data = DataSet.load(folder_with(tmp_path, time[keep], {key: value[keep] for key, value in columns.items()}))
  assert [run.name for run in data.recordings] == ["run"] and data.warnings == ()
