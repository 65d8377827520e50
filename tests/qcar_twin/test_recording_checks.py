"""What a loader must notice: broken time, numbers that are no samples, wrong units and signs, frozen and clipped channels."""

import numpy as np
import pytest
from drives import VEHICLE, drive, folder_with, recording

from qcar_twin.dataset import DataSet
from qcar_twin.defects import Runs, find_defects
from qcar_twin.mapping import held_samples
from qcar_twin.plausibility import LIMITS, check_limits, check_units, compare
from qcar_twin.recording import CHANNELS, Recording, RecordingError, Stream
from qcar_twin.validation import MIN_SAMPLES, gap_limit


def refused(tmp_path, time, columns, *texts, **manifest):
  with pytest.raises(RecordingError) as caught:
    DataSet.load(folder_with(tmp_path, time, columns, **manifest))
  for text in ("run.csv: ", *texts):
    assert text in str(caught.value)


def warned(tmp_path, time, columns, **manifest):
  return DataSet.load(folder_with(tmp_path, time, columns, **manifest)).warnings


# ---------------------------------------------------------------- time


def test_time_that_repeats(tmp_path):
  time, columns = drive()
  time[40] = time[39]
  refused(
    tmp_path, time, columns, "time repeats in row 41 (0.39 s again)", "remove the repeated rows, or set hold = true"
  )


def test_time_that_goes_backwards(tmp_path):
  time, columns = drive()
  time[[40, 41, 90, 91]] = time[[41, 40, 91, 90]]
  refused(tmp_path, time, columns, "time goes backwards in row 42 (0.4 s after 0.41 s); sort the rows by time")


def test_a_logger_that_restarted(tmp_path):
  time, columns = drive()
  time[600:] -= 6.0
  refused(
    tmp_path,
    time,
    columns,
    "time goes backwards in row 601 (0 s after 5.99 s); split the file where the logger restarted",
  )


@pytest.mark.parametrize(
  "value, text", [(np.nan, "time has no value (blank or NaN) in row 8"), (np.inf, "time is infinite in row 8")]
)
def test_time_without_a_value(tmp_path, value, text):
  time, columns = drive()
  time[[7, 9]] = value
  refused(tmp_path, time, columns, text, "and 1 more rows; delete those rows")


@pytest.mark.parametrize(
  "factor, unit, scale", [(1e3, "milliseconds", "0.001"), (1e6, "microseconds", "1e-06"), (1e9, "nanoseconds", "1e-09")]
)
@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_time_in_other_units(tmp_path, factor, unit, scale, start):
  time, columns = drive()
  refused(
    tmp_path,
    (time + start) * factor,
    columns,
    "implausible for seconds",
    f"it looks like {unit}: set time = ",
    f"scale = {scale}",
  )
  mapped = f'time = {{ column = "time", scale = {scale}, offset = {-start} }}'
  (run,) = DataSet.load(folder_with(tmp_path, (time + start) * factor, columns, channels=mapped)).recordings
  assert run["yaw_rate"].time == pytest.approx(time, abs=1e-6)


def test_time_in_hours_or_days(tmp_path):
  time, columns = drive()
  refused(tmp_path, time / 86400.0, columns, "implausibly little; is it in hours or days?")


def test_unix_seconds_are_plain_seconds(tmp_path):
  time, columns = drive()
  assert warned(tmp_path, time + 1.725e9, columns) == ()


# ---------------------------------------------------------------- samples


@pytest.mark.parametrize("rows", [1, 2, MIN_SAMPLES - 1])
def test_too_few_samples(tmp_path, rows):
  time, columns = drive()
  few = {key: value[:rows] for key, value in columns.items()}
  refused(tmp_path, time[:rows], few, f"too few samples ({rows}); at least {MIN_SAMPLES} without a gap are needed")


def test_enough_samples_are_just_enough(tmp_path):
  time, columns = drive()
  data = DataSet.load(
    folder_with(tmp_path, time[:MIN_SAMPLES], {key: value[:MIN_SAMPLES] for key, value in columns.items()})
  )
  assert len(data.recordings) == 1


def test_a_log_of_lone_samples_between_gaps_has_too_few(tmp_path):
  time, columns = drive()
  scattered = time + 2.0 * np.floor(time / 0.05)  # a handful of samples at a time
  refused(tmp_path, scattered, columns, "too few samples (6)")


@pytest.mark.parametrize("channel", ["motor_voltage", "steering_command"])
@pytest.mark.parametrize("text, what", [("nan", "NaN"), ("inf", "infinite"), ("-inf", "infinite")])
def test_bad_numbers_in_commands(tmp_path, channel, text, what):
  time, columns = drive()
  columns[channel] = columns[channel].astype(object)
  columns[channel][[16, 30]] = text
  refused(
    tmp_path, time, columns, f"{channel} is {what} in row 17 and 1 more; leave the cell blank where there is no sample"
  )


def test_a_mapped_bad_command_names_channel_and_column(tmp_path):
  time, columns = drive()
  columns["duty"] = columns.pop("motor_voltage").astype(object)
  columns["duty"][3] = "nan"
  refused(
    tmp_path,
    time,
    columns,
    "motor_voltage (column 'duty') is NaN in row 4; ",
    channels='motor_voltage = { column = "duty" }',
  )


def test_nan_in_a_measurement_is_no_sample_but_infinity_is_an_error(tmp_path):
  time, columns = drive()
  columns["yaw_rate"] = columns["yaw_rate"].astype(object)
  columns["yaw_rate"][5] = "NaN"
  (run,) = DataSet.load(folder_with(tmp_path, time, columns)).recordings
  assert len(run["yaw_rate"]) == time.size - 1
  columns["yaw_rate"][5] = "1e999"
  refused(tmp_path, time, columns, "yaw_rate is infinite in row 6")


@pytest.mark.parametrize("channel", ["motor_voltage", "motor_speed"])
def test_an_all_blank_needed_channel(tmp_path, channel):
  time, columns = drive()
  columns[channel] = np.full(time.size, np.nan)
  refused(tmp_path, time, columns, f"needed channel '{channel}' has no sample, every cell is blank; map another column")


# ---------------------------------------------------------------- held samples


@pytest.mark.parametrize(
  "value, usual, kept",
  [
    ([1, 1, 2, 2, 3, 3], 2, [0, 2, 4]),
    ([1, 2, 3], 1, [0, 1, 2]),
    ([1, 1, 1, 1, 2, 2], 2, [0, 2, 4]),
    ([1, 1, 1, 2, 2], 2, [0, 1, 3]),
    ([1, 1, 2, 2, 2, 2, 2, 2], 2, [0, 2, 4, 6]),
    ([5, 5, 5, 5], 0, [0, 3]),
    ([5], 0, [0]),
  ],
)
def test_held_samples(value, usual, kept):
  assert held_samples(np.array(value, float), usual).tolist() == kept


# ---------------------------------------------------------------- units


WRONG_UNITS = [
  (
    "steering_command",
    180.0 / np.pi,
    "steering_command reaches",
    "is it in degrees? set scale = 0.0174533 on steering_command",
  ),
  ("yaw_rate", 180.0 / np.pi, "yaw_rate reaches", "is it in deg/s? set scale = 0.0174533 on yaw_rate"),
  ("accel_x", 1 / 9.80665, "accel_x is 0.1", "is it in g? set scale = 9.80665 on accel_x"),
  ("accel_y", 1 / 9.80665, "accel_y is 0.1", "is it in g? set scale = 9.80665 on accel_y"),
  ("accel_y", 1000 / 9.80665, "accel_y", "is it in mg? set scale = 0.00980665 on accel_y"),
  ("motor_speed", 60 / (2 * np.pi), "motor_speed is 9.5", "is it in rpm? set scale = 0.10472 on motor_speed"),
  ("motor_voltage", 1000.0, "motor_voltage reaches", "is it in mV? set scale = 0.001 on motor_voltage"),
  ("pose_yaw", 180.0 / np.pi, "yaw_rate is 0.017", "is it in degrees? set scale = 0.0174533 on pose_yaw"),
]


@pytest.mark.parametrize(
  "channel, factor, complaint, cure", WRONG_UNITS, ids=[f"{row[0]} x {row[1]:.3g}" for row in WRONG_UNITS]
)
def test_wrong_units_are_named_with_the_scale_that_mends_them(tmp_path, channel, factor, complaint, cure):
  time, columns = drive()
  columns[channel] = columns[channel] * factor
  refused(tmp_path, time, columns, complaint, "implausible", cure)
  mended = f'{channel} = {{ column = "{channel}", scale = {1 / factor} }}'
  assert warned(tmp_path, time, columns, channels=mended) == ()


def test_positions_in_millimetres(tmp_path):
  time, columns = drive()
  columns |= {"pose_x": 1000.0 * columns["pose_x"], "pose_y": 1000.0 * columns["pose_y"]}
  refused(tmp_path, time, columns, "is it in mm? set scale = 0.001 on pose_x (and on pose_y)")


@pytest.mark.parametrize("factor, unit", [(3.6, "km/h"), (100.0, "cm/s"), (1000.0, "mm/s")])
def test_speed_in_other_units(tmp_path, factor, unit):
  time, columns = drive()
  columns["speed"] = columns.pop("motor_speed") * VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"] * factor
  refused(tmp_path, time, columns, "speed", f"is it in {unit}? set scale = ")


def test_small_yaw_rates_in_degrees_are_found_by_steering_alone(tmp_path):
  time, columns = drive()
  columns = {key: columns[key] for key in ("motor_voltage", "steering_command", "motor_speed", "yaw_rate")}
  columns["steering_command"] = 0.1 * columns["steering_command"]
  columns["yaw_rate"] = 0.1 * columns["yaw_rate"] * 180.0 / np.pi
  assert np.abs(columns["yaw_rate"]).max() < 15.0
  refused(tmp_path, time, columns, "yaw_rate is 5", "times motor_speed x steering / wheelbase", "is it in deg/s?")


def test_motor_speed_in_rpm_and_acceleration_in_g_look_alike_without_a_pose_so_both_are_named(tmp_path):
  time, columns = drive()
  columns = {key: columns[key] for key in ("motor_voltage", "motor_speed", "accel_x")}
  columns["motor_speed"] = columns["motor_speed"] * 60 / (2 * np.pi)
  refused(
    tmp_path,
    time,
    columns,
    "is it in g? set scale = 9.80665 on accel_x",
    "or is it in rpm? set scale = 0.10472 on motor_speed",
  )


def test_a_wrapped_heading_in_degrees_is_found_before_it_is_unwrapped(tmp_path):
  time, columns = drive()
  columns["pose_yaw"] = (200.0 * time) % 360.0
  refused(
    tmp_path,
    time,
    columns,
    "pose_yaw jumps by",
    "in degrees? set scale = 0.0174533",
    channels='pose_yaw = { column = "pose_yaw", wrap = true }',
  )


def test_a_spike_beyond_the_limit_is_no_unit(tmp_path):
  time, columns = drive()
  columns["yaw_rate"][[100, 700]] = 40.0
  assert warned(tmp_path, time, columns) == ()


@pytest.mark.parametrize("seed", range(60))
def test_a_mutilated_csv_is_loaded_or_refused_but_never_crashes(tmp_path, seed):
  random = np.random.default_rng(seed)
  folder = folder_with(tmp_path, *drive(0.5))
  content = bytearray((folder / "run.csv").read_bytes())
  for _ in range(random.integers(1, 6)):
    place = int(random.integers(len(content)))
    piece = [b",", b"\n", b"nan", b"inf", b"-", b"1e400", b'"', b"\r", b"\xff", b",,,", b"9", b"e"][random.integers(12)]
    content[place : place + int(random.integers(0, 30))] = piece
  (folder / "run.csv").write_bytes(content)
  try:
    assert all(run.commands(0.01)[1].shape[1] == 2 for run in DataSet.load(folder).recordings)
  except RecordingError as error:
    assert str(error).startswith("run.csv: ")


def test_limits_speak_of_real_channels_and_say_when():
  assert set(LIMITS) <= set(CHANNELS)
  run = Recording("a", {"motor_voltage": Stream([0.0, 0.5, 1.0], [1.0, 2.0, 2000.0]), "speed": Stream([0.0], [0.0])})
  with pytest.raises(
    RecordingError, match=r"a: motor_voltage reaches 2000 V, implausible above 100 V \(first at 1 s\)"
  ):
    check_limits(run)


def test_right_units_give_slopes_of_one():
  slopes = {f"{c.channel} / {c.witness}": c.slope() for c in compare(recording(seconds=30.0), VEHICLE)}
  assert len(slopes) == 5
  for name, (slope, correlation) in slopes.items():
    assert slope == pytest.approx(1.0, abs=0.1), name
    assert correlation > 0.9


@pytest.mark.parametrize("seed", range(5))
def test_ordinary_errors_of_sensors_are_no_units(seed):
  """Biases, scale errors up to 40 %, heavy noise: wrong, but not a wrong unit."""
  random = np.random.default_rng(seed)
  time, columns = drive(seed=seed)
  for channel, noise in (("accel_x", 1.5), ("accel_y", 1.5), ("yaw_rate", 0.1), ("motor_speed", 5.0)):
    columns[channel] = (
      columns[channel] * random.uniform(0.6, 1.4) + noise * random.standard_normal(time.size) + random.normal() * noise
    )
  run = Recording.from_columns("a", time, columns)
  check_limits(run)
  assert check_units(run, VEHICLE) == []


@pytest.mark.parametrize("channel", ["yaw_rate", "accel_y", "pose_yaw"])
def test_a_turned_sign_is_a_warning_with_the_convention(tmp_path, channel):
  time, columns = drive()
  columns[channel] = -columns[channel]
  notes = warned(tmp_path, time, columns)
  assert notes and all(
    "runs against" in note and "set scale = -1 on the channel that differs" in note for note in notes
  )


def test_nothing_is_concluded_from_standing_still():
  time = np.arange(0.0, 10.0, 0.01)
  noise = np.random.default_rng(0).normal(size=(6, time.size))
  columns = {
    "motor_voltage": 0 * time,
    "steering_command": 0.2 * np.sin(time),
    "speed": 0 * time,
    "accel_x": 0.1 * noise[0],
  }
  columns |= {
    "accel_y": 0.1 * noise[1],
    "yaw_rate": 0.01 * noise[2],
    "pose_x": 0.001 * noise[3],
    "pose_y": 0.001 * noise[4],
    "pose_yaw": 0.001 * noise[5],
  }
  run = Recording.from_columns("a", time, columns)
  assert check_units(run, VEHICLE) == [] and find_defects(run) == []


def test_vehicle_numbers_may_be_missing():
  assert len(compare(recording(), {})) >= 3
  assert check_units(recording(), {}) == []


# ---------------------------------------------------------------- defects


def test_runs():
  runs = Runs.of(np.array([1.0, 1.0, 2.0, 1.0, 1.0, 1.0]))
  assert (runs.first.tolist(), runs.last.tolist(), runs.value.tolist(), runs.length.tolist()) == (
    [0, 2, 3],
    [1, 2, 5],
    [1, 2, 1],
    [2, 1, 3],
  )


@pytest.mark.parametrize("channel", ["yaw_rate", "accel_x", "accel_y"])
def test_a_frozen_sensor_is_named_with_its_span(tmp_path, channel):
  time, columns = drive()
  columns[channel][300:500] = 0.25
  assert warned(tmp_path, time, columns) == (
    f"run.csv: {channel} is frozen at 0.25 from 3 s to 4.99 s; do not trust it there",
  )


def test_a_frozen_pose_matters_only_while_the_car_moves(tmp_path):
  time, columns = drive()
  for channel in ("pose_x", "pose_y"):
    columns[channel][300:400] = columns[channel][300]
  (note,) = warned(tmp_path, time, columns)
  assert "pose_x, pose_y is frozen" in note and "from 3 s to 3.99 s; the car moved, so tracking was lost there" in note


def test_an_encoder_stuck_at_zero_is_told_from_a_standing_car(tmp_path):
  time, columns = drive()
  columns = {key: columns[key] for key in ("motor_voltage", "motor_speed")}
  columns["motor_voltage"][800:] = 6.0
  columns["motor_speed"][800:] = 0.0
  (note,) = warned(tmp_path, time, columns)
  assert "motor_speed is frozen at 0 from 8 s to 11.99 s; a stuck encoder, or a car held by static friction" in note
  columns["motor_voltage"][800:] = 0.0
  assert warned(tmp_path, time, columns) == ()


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
