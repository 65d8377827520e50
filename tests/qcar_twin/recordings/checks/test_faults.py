"""What a loader must notice: frozen and clipped channels."""

import numpy as np
import pytest

from calibration.log_check import check_log
from qcar_twin.recordings.checks.faults import Runs, find_defects
from qcar_twin.recordings.checks.time import gap_limit
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from tests.qcar_twin.recordings.drives import drive
from tests.qcar_twin.recordings.loading import warned


def test_runs():
  runs = Runs.of(np.array([1.0, 1.0, 2.0, 1.0, 1.0, 1.0]))
  assert (runs.first.tolist(), runs.last.tolist(), runs.value.tolist(), runs.length.tolist()) == (
    [0, 2, 3],
    [1, 2, 5],
    [1, 2, 1],
    [2, 1, 3],
  )


@pytest.mark.parametrize("channel", ["accel_x", "accel_y"])
def test_samples_at_which_an_accelerometer_stuck_are_left_out_and_said(tmp_path, channel):
  time, columns = drive()
  columns[channel][300:500] = 0.25
  assert warned(tmp_path, time, columns) == (
    f"run.csv: {channel} is frozen at 0.25 from 3 s to 4.99 s; it stuck there; those samples are left out",
  )
  (run,) = DataSet.load(tmp_path).recordings
  assert run[channel].time[300:302] == pytest.approx([3.0, 5.0]) and len(run["yaw_rate"]) == len(time)


@pytest.mark.parametrize("channel", ["yaw_rate", "motor_speed"])
def test_a_recording_is_cut_where_a_gyro_or_a_speed_stuck(tmp_path, channel):
  time, columns = drive()
  columns["motor_voltage"][300:500:40] *= 0.2
  columns[channel][300:500] = 0.25
  (note,) = warned(tmp_path, time, columns)
  assert f"{channel} is frozen at 0.25 from 3 s to 4.99 s; it stuck there; that part of the recording is left" in note
  first, second = DataSet.load(tmp_path).recordings
  assert (first.end, second.start) == pytest.approx((3.0, 5.0))


def test_a_gyro_that_stuck_all_the_time_is_named_and_cuts_nothing(tmp_path):
  time, columns = drive()
  columns["yaw_rate"][400:] = np.median(columns["yaw_rate"][:400])
  (note,) = warned(tmp_path, time, columns)
  assert "yaw_rate is frozen at" in note and "do not trust it there" in note
  assert len(DataSet.load(tmp_path).recordings) == 1


def test_a_speed_that_ignores_a_duty_is_frozen_as_one_that_ignores_a_voltage():
  time, columns = drive()
  columns = {"motor_duty": columns["motor_voltage"] / 12.0, "speed": 0.003 * columns["motor_speed"]}
  columns["speed"][500:700] = 0.8
  assert any("speed is frozen at 0.8" in note for note in find_defects(Recording.from_columns("a", time, columns)))


def test_a_frozen_pose_matters_only_while_the_car_moves(tmp_path):
  time, columns = drive()
  for channel in ("pose_x", "pose_y"):
    columns[channel][300:400] = columns[channel][300]
  (note,) = warned(tmp_path, time, columns)
  (run,) = DataSet.load(tmp_path).recordings
  for channel in ("pose_x", "pose_y", "pose_yaw"):
    assert run[channel].time[299:301] == pytest.approx([2.99, 4.0])
  assert (
    "pose_x, pose_y is frozen" in note
    and "from 3 s to 3.99 s; the car moved, so tracking was lost there; those" in note
  )


def test_an_encoder_stuck_at_zero_is_told_from_a_standing_car(tmp_path):
  time, columns = drive()
  columns = {key: columns[key] for key in ("motor_voltage", "motor_speed")}
  columns["motor_voltage"][800:] = 6.0
  columns["motor_speed"][800:] = 0.0
  (note,) = warned(tmp_path, time, columns)
  assert "motor_speed is frozen at 0 from 8 s to 11.99 s; a stuck encoder, or a car held by static friction" in note
  columns["motor_voltage"][800:] = 0.0
  assert warned(tmp_path, time, columns) == ()


def test_an_encoder_stuck_at_zero_is_left_out_where_a_pose_moves_whatever_was_commanded(tmp_path):
  time, columns = drive()
  columns["motor_speed"][800:1000] = 0.0
  notes = warned(tmp_path, time, columns)
  assert any("motor_speed is frozen at 0 from 8 s to 9.99 s; it stuck there; that part" in note for note in notes)
  assert [r.end for r in DataSet.load(tmp_path).recordings] == pytest.approx([8.0, 11.99])


def test_a_car_that_stands_while_its_pose_trembles_is_no_stuck_encoder(tmp_path):
  time, columns = drive()
  random = np.random.default_rng(1)
  columns["motor_speed"][:80] = columns["motor_voltage"][:80] = 0.0
  for name in ("pose_x", "pose_y"):
    columns[name][:80] = columns[name][80] + 0.03 * random.standard_normal(80)
  assert not any("frozen" in note for note in warned(tmp_path, time, columns))


def test_a_gyro_that_was_unplugged_is_frozen_though_the_car_stands_now_and_then(tmp_path):
  time, columns = drive()
  columns["yaw_rate"][600:1100] = 0.0
  columns["motor_speed"][900:950] = 0.0
  for name in ("pose_x", "pose_y", "pose_yaw"):
    del columns[name]
  assert any("yaw_rate is frozen at 0 from 6 s to 10.99 s" in note for note in warned(tmp_path, time, columns))


def test_a_speed_that_ignores_the_voltage_is_frozen(tmp_path):
  time, columns = drive()
  columns = {key: columns[key] for key in ("motor_voltage", "motor_speed")}
  columns["motor_speed"][500:700] = 123.0
  (note,) = warned(tmp_path, time, columns)
  assert "motor_speed is frozen at 123 from 5 s to 6.99 s" in note


@pytest.mark.parametrize("channel, bound", [("yaw_rate", 0.9), ("accel_y", 0.8), ("accel_x", 0.7)])
def test_clipping_is_named_with_its_span(tmp_path, channel, bound):
  time, columns = drive()
  value = columns[channel]
  clipped = np.clip(value, -bound, bound)
  assert (clipped != value).sum() > 10
  columns[channel] = clipped
  notes = warned(tmp_path, time, columns)
  assert notes and all(
    f"run.csv: {channel} is clipped at " in note and "sensor range is too small" in note for note in notes
  )


def test_smooth_extremes_saturated_commands_and_coarse_encoders_are_not_clipped(tmp_path):
  time, columns = drive()
  columns["steering_command"] = np.clip(columns["steering_command"], -0.2, 0.2)
  columns["motor_speed"] = 5.0 * np.round(columns["motor_speed"] / 5.0)
  columns["accel_x"] = np.gradient(0.8 + 0.5 * np.sin(1.7 * time), time)
  assert not any("clipped" in note for note in warned(tmp_path, time, columns))


def test_a_channel_that_falls_silent_is_mentioned(tmp_path):
  time, columns = drive()
  for channel in ("pose_x", "pose_y", "pose_yaw"):
    columns[channel][400:520] = np.nan
  notes = warned(tmp_path, time, columns)
  assert len(notes) == 3
  assert notes[0] == "run.csv: pose_x has no sample from 3.99 s to 5.2 s; it is interpolated there"
  for channel in ("pose_x", "pose_y", "pose_yaw"):
    columns[channel] = drive()[1][channel]
    columns[channel][400:] = np.nan
  notes = warned(tmp_path, time, columns)
  assert notes[0] == "run.csv: pose_x has no sample from 3.99 s to 11.99 s; nothing of it is known there"


def test_a_noise_free_drive_raises_no_warning(tmp_path):
  """A simulator's straight run: yaw rate exactly zero, speed constant in the end."""
  time = np.arange(0.0, 6.0, 0.01)
  speed = 1.0 - np.exp(-time / 0.2)
  columns = {
    "motor_voltage": np.full(time.size, 4.0),
    "steering_command": 0 * time,
    "speed": np.round(speed, 9),
    "accel_x": np.exp(-time / 0.2) / 0.2,
  }
  columns |= {
    "accel_y": 0 * time,
    "yaw_rate": 0 * time,
    "pose_x": np.cumsum(speed) * 0.01,
    "pose_y": 0 * time,
    "pose_yaw": 0 * time,
  }
  assert warned(tmp_path, time, columns) == ()


@pytest.mark.parametrize("step, limit", [(0.002, 0.25), (0.01, 0.25), (0.1, 0.5), (1.0, 5.0)])
def test_gap_limit_scales_with_the_usual_step(step, limit):
  assert gap_limit(step) == pytest.approx(limit)


def exact_car(seconds=40.0, rate=50.0):
  """A car without noise: it stands, then follows speeds and angles in steps, 20 ms late; its speed is in cm/s."""
  time = np.arange(int(seconds * rate)) / rate
  phase = (time // 4.0).astype(int)
  command = np.array([0.0, 1.0, 0.5, 1.4, 0.8, 0.3, 1.2, 0.6, 1.0, 0.0])[phase]
  angle = np.array([0.0, 0.0, 0.2, 0.2, 0.0, -0.2, 0.0, 0.0, 0.1, 0.1])[phase]
  speed, wheels = np.zeros(time.size), np.zeros(time.size)
  for k in range(2, time.size):
    speed[k] = speed[k - 1] + np.clip(command[k - 2] - speed[k - 1], -0.08, 0.06)
    wheels[k] = wheels[k - 1] + np.clip(angle[k - 2] - wheels[k - 1], -0.02, 0.02)
  rate_of = np.round(speed * np.tan(wheels) / 0.256, 6)
  columns = {"speed_command": command, "steering_command": angle, "speed": np.round(speed, 2), "yaw_rate": rate_of}
  return time, columns


def test_a_steady_speed_in_whole_centimetres_and_a_gyro_without_noise_are_not_frozen():
  time, columns = exact_car()
  assert not any("frozen" in note for note in find_defects(Recording.from_columns("a", time, columns)))
  stuck = {name: values.copy() for name, values in columns.items()}
  for name in ("speed", "yaw_rate"):
    stuck[name][480:700] = stuck[name][480]
  notes = find_defects(Recording.from_columns("a", time, stuck))
  assert sum(f"{name} is frozen at" in note for note in notes for name in ("speed", "yaw_rate")) == 2


def test_samples_at_the_end_of_a_gyros_range_are_left_out_and_pass_for_no_scale(tmp_path):
  time, columns = drive(60.0)
  bound = 0.9
  columns["yaw_rate"] = np.clip(columns["yaw_rate"], -bound, bound)
  notes = warned(tmp_path, time, columns)
  assert ["yaw_rate is clipped at 0.9 and -0.9" in note for note in notes] == [True]
  (run,) = DataSet.load(tmp_path).recordings
  assert np.abs(run["yaw_rate"].value).max() < bound and len(run["yaw_rate"]) > 0.5 * len(time)
  assert not any("yaw_rate reads" in f.text for f in check_log(DataSet.load(tmp_path)).findings)
