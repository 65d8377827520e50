"""Steps found in commands of every kind, steady ends, and a moving average without phase."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.identification import step_detection
from calibration.identification.step_detection import PERIOD, find_steps, moving_average, settled_rows
from qcar_twin.recordings.recording import Recording

TIME = PERIOD * np.arange(600)


def run(command, response=None, channel="motor_voltage", name="run"):
  response = 100.0 * (1.0 - np.exp(-np.maximum(TIME - 1.0, 0.0) / 0.3)) if response is None else response
  return Recording.from_columns(name, TIME, {channel: command, "motor_speed": response}, manoeuvre="voltage_step")


def steps(command, start_at_rest=True, **kwargs):
  return find_steps([run(command, **kwargs)], "motor_voltage", "motor_speed", 0.1, start_at_rest)


def test_jump_is_found_with_its_row_and_level():
  (step,) = steps(np.where(TIME < 1.0, 0.0, 1.5))
  assert step.level == 1.5
  assert step.first == 100
  np.testing.assert_allclose(step.time[step.first], 0.0, atol=1e-12)
  np.testing.assert_array_equal(step.commands[step.first - 1 : step.first + 1, 0], [0.0, 1.5])
  assert step.recording == "run"


def test_ramp_of_a_tenth_of_a_second_is_one_step_from_where_it_begins():
  (step,) = steps(np.clip((TIME - 1.0) * 15.0, 0.0, 1.5))
  assert step.level == 1.5
  assert abs(step.first - 100) <= 1


def test_slow_ramp_and_sine_are_no_steps():
  assert not steps(np.clip((TIME - 1.0) * 0.3, 0.0, 1.5))
  assert not steps(1.0 + np.sin(6.0 * TIME))


def test_staircase_gives_a_step_each_and_rest_is_none():
  command = np.select([TIME < 1.0, TIME < 2.5, TIME < 4.5], [0.0, 1.0, 2.0], 0.0)
  levels = [(s.level, round(len(s.time[s.first :]) * PERIOD, 2)) for s in steps(command)]
  assert levels == [(1.0, 1.5), (2.0, 2.0)]


def test_command_on_from_the_start_counts_only_for_a_car_that_starts_at_rest():
  (step,) = steps(np.full(600, 0.8))
  assert (step.first, step.level) == (0, 0.8)
  assert not steps(np.full(600, 0.8), start_at_rest=False)


def test_short_and_small_commands_are_no_steps():
  assert not steps(np.where((TIME > 1.0) & (TIME < 1.5), 1.0, 0.0))
  assert not steps(np.where(TIME > 1.0, 0.05, 0.0))


@settings(max_examples=30)
@given(st.floats(0.3, 3.0), st.integers(60, 300), st.sampled_from([-1.0, 1.0]))
def test_any_clean_step_is_found_at_its_row(level, row, sign):
  command = np.zeros(600)
  command[row:] = sign * level
  (step,) = steps(command)
  assert step.level == sign * level
  assert round((step.time[0] + row * PERIOD) / PERIOD) == max(row - 100, 0)


def test_tremor_does_not_hide_a_step():
  tremor = 0.01 * np.random.default_rng(0).standard_normal(600)
  (step,) = steps(np.where(TIME < 1.0, 0.0, 1.5) + tremor)
  assert abs(step.level - 1.5) < 0.01
  assert abs(step.first - 100) <= 1


def test_recordings_without_the_channels_are_passed_over():
  bare = Recording.from_columns("bare", TIME, {"motor_speed": TIME}, manoeuvre="voltage_step")
  assert not find_steps([bare], "motor_voltage", "motor_speed", 0.1, True)


def test_steady_end_of_an_exponential_is_late_enough():
  """The mean over the steady window is within half a per cent of the limit for time constants up to 1 s."""
  time = PERIOD * np.arange(500)
  for constant in (0.1, 0.3, 0.6, 1.0):
    values = 100.0 * (1.0 - np.exp(-time / constant))
    first = settled_rows(values)
    assert first is not None
    left = np.mean(np.exp(-time[first:] / constant))
    assert left < (0.005 if constant < 0.9 else 0.03)


def test_response_far_from_its_end_has_no_steady_rows():
  assert settled_rows(PERIOD * np.arange(500)) is None
  assert settled_rows(np.ones(10)) is None


def test_noise_does_not_shorten_the_steady_window():
  rng = np.random.default_rng(1)
  quiet = settled_rows(np.ones(400))
  noisy = settled_rows(1.0 + 0.1 * rng.standard_normal(400))
  assert quiet == noisy == 120


def test_moving_average_has_no_phase_and_keeps_lines():
  """A straight line passes unchanged (also at the ends of its symmetric part); a symmetric pulse stays symmetric."""
  line = np.arange(50.0)
  np.testing.assert_allclose(moving_average(line, 0.1)[5:-5], line[5:-5], atol=1e-10)
  pulse = np.zeros(51)
  pulse[25] = 1.0
  smooth = moving_average(pulse, 0.1)
  np.testing.assert_allclose(smooth, smooth[::-1], atol=1e-12)
  np.testing.assert_allclose(smooth.sum(), 1.0)


def test_moving_average_is_the_mean_of_what_there_is_at_the_ends():
  values = np.array([[1.0, 2.0, 6.0, 4.0], [0.0, 0.0, 0.0, 4.0]])
  np.testing.assert_allclose(moving_average(values, 2 * PERIOD), [[1.5, 3.0, 4.0, 5.0], [0.0, 0.0, 4 / 3, 2.0]])


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_standard_error_covers_the_scatter_of_means(correlation):
  rng, means, errors = np.random.default_rng(2), [], []
  for _ in range(300):
    noise = rng.standard_normal(400)
    for k in range(1, 400):
      noise[k] += correlation * noise[k - 1]
    means.append(noise.mean())
    errors.append(step_detection.standard_error(noise))
  assert 0.75 < np.sqrt(np.mean(np.square(errors))) / np.std(means) < 1.25
