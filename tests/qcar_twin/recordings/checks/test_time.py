"""What a loader must notice: broken time, numbers that are no samples."""

import numpy as np
import pytest

from qcar_twin.recordings.checks.time import MIN_SAMPLES, turn_of
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.mapping import published_samples
from tests.qcar_twin.recordings.drives import drive, folder_with
from tests.qcar_twin.recordings.loading import refused_run, warned

# ---------------------------------------------------------------- time


def test_a_row_that_was_written_twice_counts_once_and_is_said(tmp_path):
  time, columns = drive()
  twice = np.r_[np.arange(40), 39, np.arange(40, time.size)]
  log = {name: values[twice].copy() for name, values in columns.items()}
  log["motor_speed"][40] += 1.0
  data = DataSet.load(folder_with(tmp_path, time[twice], log))
  (run,) = data.recordings
  assert run["motor_speed"].time == pytest.approx(time)
  assert (run["motor_speed"].value == columns["motor_speed"]).all()
  assert data.warnings[0].endswith(
    "1 of 1201 rows repeat the time of the row before, first row 41 (0.39 s again); left out"
  )


def test_time_that_repeats_often(tmp_path):
  time, columns = drive()
  time[40:160:2] = time[39:159:2]  # a twentieth of the rows
  time[200] = time[199]
  refused_run(tmp_path, time, columns, "time repeats in row 41 (0.39 s again)", "set time = { rate = ")


def test_time_that_goes_backwards(tmp_path):
  time, columns = drive()
  time[[40, 41, 90, 91]] = time[[41, 40, 91, 90]]
  refused_run(tmp_path, time, columns, "time goes backwards in row 42 (0.4 s after 0.41 s); set sort = true on time")


def test_a_block_of_rows_that_was_written_twice(tmp_path):
  time, columns = drive()
  twice = np.r_[np.arange(600), np.arange(400, time.size)]
  refused_run(
    tmp_path,
    time[twice],
    {name: values[twice] for name, values in columns.items()},
    "time goes backwards in row 601 (4 s after 5.99 s); rows 601 to 800 have times that were there already",
  )


def test_a_logger_that_restarted(tmp_path):
  time, columns = drive()
  time[600:] -= 6.0
  refused_run(
    tmp_path,
    time,
    columns,
    "time goes backwards in row 601 (0 s after 5.99 s); split the file where the logger restarted",
  )


@pytest.mark.parametrize(("hours", "back"), [(1, 3600.0), (1, 3600.4), (2, 7200.0)])
def test_a_clock_of_the_day_that_was_set_back_by_hours_says_so(tmp_path, hours, back):
  time, columns = drive()
  stamps = time + 1.7594e9
  stamps[600:] -= back
  cure = f"split the file before row 601, or add {3600 * hours} s to the times from that row on"
  refused_run(tmp_path, stamps, columns, "time goes backwards in row 601", f"was set back by {hours} h", cure)


def test_a_second_drive_after_an_hour_is_a_restart(tmp_path):
  time, columns = drive()
  stamps = np.r_[time[:600] * 3600.0 / time[600], time[600:] - time[600]]
  refused_run(tmp_path, stamps, columns, "row 601", "split the file where the logger restarted")


@pytest.mark.parametrize(
  "value, text", [(np.nan, "time has no value (blank or NaN) in row 8"), (np.inf, "time is infinite in row 8")]
)
def test_time_without_a_value(tmp_path, value, text):
  time, columns = drive()
  time[[7, 9]] = value
  refused_run(tmp_path, time, columns, text, "and 1 more rows; delete those rows")


@pytest.mark.parametrize(
  "factor, unit, scale", [(1e3, "milliseconds", "0.001"), (1e6, "microseconds", "1e-06"), (1e9, "nanoseconds", "1e-09")]
)
@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_time_in_other_units(tmp_path, factor, unit, scale, start):
  time, columns = drive()
  refused_run(
    tmp_path,
    (time + start) * factor,
    columns,
    "implausible for seconds",
    f"it looks like {unit}; set time = ",
    f"scale = {scale}",
  )
  mapped = f'time = {{ column = "time", scale = {scale}, offset = {-start} }}'
  (run,) = DataSet.load(folder_with(tmp_path, (time + start) * factor, columns, channels=mapped)).recordings
  assert run["yaw_rate"].time == pytest.approx(time, abs=1e-6)


def test_a_scale_of_the_clock_that_is_not_needed_is_said(tmp_path):
  time, columns = drive()
  channels = 'time = { column = "time", scale = 0.001 }'
  with pytest.raises(ValueError, match="implausibly little; take scale = 0.001 off time in"):
    DataSet.load(folder_with(tmp_path, time, columns, channels=channels))


def test_time_in_hours_or_days(tmp_path):
  time, columns = drive()
  refused_run(tmp_path, time / 86400.0, columns, "implausibly little; is it in hours or days?")


def test_unix_seconds_are_plain_seconds(tmp_path):
  time, columns = drive()
  assert warned(tmp_path, time + 1.725e9, columns) == ()


# ---------------------------------------------------------------- samples


@pytest.mark.parametrize("rows", [1, 2, MIN_SAMPLES - 1])
def test_too_few_samples(tmp_path, rows):
  time, columns = drive()
  few = {key: value[:rows] for key, value in columns.items()}
  refused_run(tmp_path, time[:rows], few, f"too few samples ({rows}); at least {MIN_SAMPLES} without a gap are needed")


def test_enough_samples_are_just_enough(tmp_path):
  time, columns = drive()
  data = DataSet.load(
    folder_with(tmp_path, time[:MIN_SAMPLES], {key: value[:MIN_SAMPLES] for key, value in columns.items()})
  )
  assert len(data.recordings) == 1


def test_a_log_of_lone_samples_between_gaps_has_too_few(tmp_path):
  time, columns = drive()
  scattered = time + 2.0 * np.floor(time / 0.05)  # a handful of samples at a time
  refused_run(tmp_path, scattered, columns, "too few samples (6)")


@pytest.mark.parametrize("channel", ["motor_voltage", "steering_command"])
@pytest.mark.parametrize("text, what", [("nan", "NaN"), ("inf", "infinite"), ("-inf", "infinite")])
def test_bad_numbers_in_commands(tmp_path, channel, text, what):
  time, columns = drive()
  columns[channel] = columns[channel].astype(object)
  columns[channel][[16, 30]] = text
  refused_run(
    tmp_path, time, columns, f"{channel} is {what} in row 17 and 1 more; leave the cell blank where there is no sample"
  )


def test_a_mapped_bad_command_names_channel_and_column(tmp_path):
  time, columns = drive()
  columns["duty"] = columns.pop("motor_voltage").astype(object)
  columns["duty"][3] = "nan"
  refused_run(
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
  refused_run(tmp_path, time, columns, "yaw_rate is infinite in row 6")


@pytest.mark.parametrize("channel", ["motor_voltage", "motor_speed"])
def test_an_all_blank_needed_channel(tmp_path, channel):
  time, columns = drive()
  columns[channel] = np.full(time.size, np.nan)
  refused_run(
    tmp_path, time, columns, f"needed channel '{channel}' has no sample, every cell is blank; map another column"
  )


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
def test_published_samples(value, usual, kept):
  assert published_samples(np.array(value, float), usual).tolist() == kept


def test_an_uneven_publisher_s_longer_wait_is_one_sample_and_a_constant_is_not():
  value = np.array([1, 1, 2, 2, 2, 3, 3, 3, 3, 4, 4, 5, 5, 5, 5, 5, 5], float)
  assert published_samples(value, 2, 3).tolist() == [0, 2, 5, 9, 11, 13, 15]


def test_a_clock_that_was_set_back(tmp_path):
  time, columns = drive()
  time[600:] -= 2.0
  cure = "rows 601 to 800 have times that were there already, and other values: the clock was set back by 1.99 s"
  refused_run(tmp_path, time, columns, cure, "split the file before row 601")


def test_a_turn_at_which_noise_goes_to_and_fro_is_a_turn():
  random = np.random.default_rng(3)
  heading = np.r_[np.full(200, 0.0), np.linspace(0.0, 40.0, 1000)] + 0.01 * random.standard_normal(1200)
  assert turn_of(np.mod(heading, 2.0 * np.pi)) == 2.0 * np.pi
  assert turn_of(np.mod(np.degrees(heading), 360.0)) == 360.0
  assert turn_of(np.cumsum(np.full(50, 6.0))) == 0.0  # turns by 0.95 of a turn a sample


def test_a_heading_once_a_second_jumps_by_a_turn_less_what_it_turned_meanwhile():
  """As of GPS in a car that goes round tight corners: steps of up to 80 degrees, and jumps of as little as 280."""
  rate = 55.0 + 25.0 * np.sin(0.7 * np.arange(60))  # degrees a second
  assert turn_of(np.mod(np.cumsum(rate), 360.0)) == 360.0
  assert turn_of(np.random.default_rng(3).uniform(0.0, 360.0, 60)) == 0.0
