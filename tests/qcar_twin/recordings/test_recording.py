"""Recording and Stream: asynchronous samples, windows, zero-order hold, resampling, errors with their cure."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from qcar_twin.recordings.recording import (
  ROLES,
  Recording,
  RecordingError,
  Stream,
  UnknownChannelError,
  nearest,
)
from tests.qcar_twin.recordings.drives import drive, recording


def steps(time, value):
  return Stream(np.array(time, float), np.array(value, float))


def test_stream_is_read_only_and_does_not_follow_the_array_it_was_made_from():
  value = np.array([1.0, 2.0])
  stream = Stream(np.array([0.0, 1.0]), value)
  value[0] = 9.0
  assert stream.value[0] == 1.0
  with pytest.raises(ValueError, match="read-only"):
    stream.time[0] = 5.0


@pytest.mark.parametrize(
  "time, value, text",
  [
    ([0.0, 1.0], [1.0], "one length"),
    ([[0.0, 1.0]], [[1.0, 2.0]], "one length"),
    ([0.0, np.nan], [1.0, 2.0], "only finite samples"),
    ([0.0, 1.0], [1.0, np.inf], "only finite samples"),
    ([0.0, 1.0, 1.0], [1.0, 2.0, 3.0], "1 s follows 1 s at sample 3"),
    ([0.0, 1.0, 0.5], [1.0, 2.0, 3.0], "0.5 s follows 1 s at sample 3"),
  ],
)
def test_stream_refuses_what_is_no_stream(time, value, text):
  with pytest.raises(RecordingError, match=text):
    Stream(np.array(time), np.array(value))


def test_hold_takes_the_last_value_at_or_before_and_the_first_value_earlier():
  stream = steps([1.0, 2.0, 4.0], [10.0, 20.0, 40.0])
  assert stream.at(np.array([0.0, 1.0, 1.999, 2.0, 3.9, 4.0, 9.0])).tolist() == [
    10.0,
    10.0,
    10.0,
    20.0,
    20.0,
    40.0,
    40.0,
  ]


def test_interpolation_is_linear_inside_and_unknown_outside():
  stream = steps([1.0, 2.0], [10.0, 20.0])
  value = stream.interpolate(np.array([0.9, 1.0, 1.25, 2.0, 2.1]))
  assert value[1:4].tolist() == [10.0, 12.5, 20.0]
  assert np.isnan(value[[0, 4]]).all()


def test_columns_become_streams_of_their_own_rate():
  time = np.array([0.0, 0.1, 0.2, 0.3])
  run = Recording.from_columns(
    "a", time, {"motor_voltage": [1.0, 1.0, 1.0, 1.0], "speed": [np.nan, 0.5, np.nan, 0.7], "yaw_rate": [np.nan] * 4}
  )
  assert run.channels == ("motor_voltage", "speed")
  assert run["speed"].time.tolist() == [0.1, 0.3]
  assert (run.start, run.end, run.duration) == (0.0, 0.3, 0.3)
  assert "speed" in run and "yaw_rate" not in run


def test_channels_come_in_canonical_order_whatever_the_order_given():
  one = steps([0.0], [1.0])
  assert Recording("a", {"pose_x": one, "speed": one, "motor_voltage": one}).channels == (
    "motor_voltage",
    "speed",
    "pose_x",
  )


def test_recording_cannot_be_changed_in_place():
  run = recording()
  with pytest.raises(dataclasses.FrozenInstanceError):
    run.name = "other"
  with pytest.raises(TypeError):
    run.streams["speed"] = steps([0.0], [1.0])


@pytest.mark.parametrize(
  "name, text",
  [
    ("yawrate", "recording 'run': unknown channel 'yawrate'; did you mean 'yaw_rate'"),
    ("speed", "recording 'run': has no channel 'speed'; did you mean 'motor_speed'"),
    ("qqqq", "unknown channel 'qqqq'; valid are: motor_voltage, steering_command"),
  ],
)
def test_absent_channel_names_the_nearest(name, text):
  with pytest.raises(KeyError) as caught:
    recording()[name]
  assert text in str(caught.value) and not str(caught.value).startswith(("'", '"'))
  assert isinstance(caught.value, RecordingError)


def test_unknown_channel_role_and_emptiness_are_refused_at_construction():
  one = steps([0.0], [1.0])
  with pytest.raises(UnknownChannelError, match="unknown channel 'steering'; did you mean 'steering_command'"):
    Recording("a", {"steering": one})
  with pytest.raises(UnknownChannelError, match="unknown channel 'time'"):
    Recording("a", {"time": one})
  with pytest.raises(RecordingError, match="unknown role 'identity'; did you mean 'identify'"):
    Recording("a", {"speed": one}, role="identity")
  with pytest.raises(RecordingError, match="'a' holds no samples"):
    Recording("a", {"speed": steps([], [])})


def test_from_columns_says_which_channel_is_bad():
  with pytest.raises(RecordingError, match="recording 'a', yaw_rate: a stream holds only finite samples"):
    Recording.from_columns("a", np.arange(3.0), {"speed": np.ones(3), "yaw_rate": np.array([0.0, np.inf, 0.0])})


def test_window_keeps_the_samples_inside_and_the_command_in_force():
  run = Recording(
    "a",
    {
      "motor_voltage": steps([0.0, 1.0, 3.0], [1.0, 2.0, 3.0]),
      "speed": steps([0.5, 1.5, 2.5, 3.5], [5.0, 6.0, 7.0, 8.0]),
    },
  )
  part = run.window(1.2, 2.6)
  assert part["motor_voltage"].time.tolist() == [1.2] and part["motor_voltage"].value.tolist() == [2.0]
  assert part["speed"].time.tolist() == [1.5, 2.5]
  assert part.name == "a" and part.start == 1.2


def test_window_without_measurements_says_where_the_recording_is():
  with pytest.raises(RecordingError, match="no measurement between 50 s and 60 s: it runs from 0 s to 11.99 s"):
    recording().window(50.0, 60.0)


def test_commands_are_held_on_the_grid_and_absent_steering_is_zero():
  run = Recording(
    "a", {"motor_voltage": steps([0.0, 0.1, 0.25], [1.0, 2.0, 3.0]), "speed": steps([0.0, 0.3], [0.0, 1.0])}
  )
  time, commands = run.commands(0.05)
  assert time == pytest.approx(np.arange(7) * 0.05)
  assert commands[:, 0].tolist() == [1.0, 1.0, 2.0, 2.0, 2.0, 3.0, 3.0]
  assert commands[:, 1].tolist() == [0.0] * 7


def test_commands_on_their_own_grid_come_back_without_rounding_slips():
  time = np.round(0.01 * np.arange(1200), 10)
  value = np.arange(1200.0)
  run = Recording.from_columns("a", time, {"motor_voltage": value, "speed": value})
  grid, commands = run.commands(0.01)
  assert grid.size == 1200 and (commands[:, 0] == value).all()


def test_command_before_its_first_sample_has_the_first_value():
  run = Recording("a", {"motor_voltage": steps([0.5, 0.6], [3.0, 4.0]), "speed": steps([0.0, 1.0], [0.0, 1.0])})
  _, commands = run.commands(0.25)
  assert commands[:, 0].tolist() == [3.0, 3.0, 3.0, 4.0, 4.0]


def test_resample_shares_the_grid_of_commands_holds_commands_and_interpolates_measurements():
  run = Recording("a", {"motor_voltage": steps([0.0, 0.5], [1.0, 2.0]), "speed": steps([0.25, 0.75], [1.0, 2.0])})
  columns = run.resample(0.25)
  assert columns["time"].tolist() == [0.0, 0.25, 0.5, 0.75]
  assert columns["motor_voltage"].tolist() == [1.0, 1.0, 2.0, 2.0]
  assert np.isnan(columns["speed"][0]) and columns["speed"][1:].tolist() == [1.0, 1.5, 2.0]
  assert (run.commands(0.25)[0] == columns["time"]).all()


@pytest.mark.parametrize("period", [0.0, -0.01, float("nan")])
def test_period_must_be_positive(period):
  with pytest.raises(RecordingError, match="period must be positive"):
    recording().commands(period)


def test_columns_and_from_columns_are_inverse_for_asynchronous_streams():
  time, columns = drive(2.0)
  columns = {
    "motor_voltage": columns["motor_voltage"],
    "yaw_rate": np.where(np.arange(time.size) % 3, np.nan, columns["yaw_rate"]),
  }
  run = Recording.from_columns("a", time, columns)
  again = Recording.from_columns("a", *run.columns())
  for channel in run.channels:
    assert (run[channel].time == again[channel].time).all() and (run[channel].value == again[channel].value).all()


@settings(max_examples=50, deadline=None)
@given(
  gaps=arrays(float, st.integers(2, 40), elements=st.floats(1e-3, 0.5)),
  cut=st.floats(0.0, 1.0),
)
def test_a_window_answers_the_hold_exactly_like_the_whole(gaps, cut):
  time = np.cumsum(gaps)
  whole = Recording.from_columns(
    "a", time, {"motor_voltage": np.arange(time.size, dtype=float), "speed": np.ones(time.size)}
  )
  start = time[0] + cut * (time[-1] - time[0])
  part = whole.window(start, time[-1])
  asked = np.linspace(start, time[-1], 37)
  assert (part["motor_voltage"].at(asked) == whole["motor_voltage"].at(asked)).all()


def test_nearest_prefers_a_close_name_and_lists_all_when_none_is_close():
  assert nearest("identfy", ROLES) == "; did you mean 'identify'?"
  assert nearest("xyz", ROLES) == "; valid are: identify, validate, holdout"
  assert nearest("xyz", ()) == ""
