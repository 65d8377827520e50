"""Held commands on a grid that their rows do not keep to."""

import numpy as np
import pytest

from qcar_twin.recordings import held
from qcar_twin.recordings.recording import Recording, Stream

PERIOD = 0.01


def test_a_change_within_a_period_counts_for_the_rest_of_it():
  command = Stream(np.array([0.0, 0.013, 0.018, 0.03]), np.array([1.0, 2.0, 5.0, 0.0]))
  time = PERIOD * np.arange(4)
  np.testing.assert_allclose(held.means(command, time, PERIOD), [1.0, 0.3 + 0.5 * 2.0 + 0.2 * 5.0, 5.0, 0.0])


def test_before_its_first_sample_a_command_has_that_value_and_after_the_grid_nothing_counts():
  command = Stream(np.array([0.025, 0.031, 0.044]), np.array([2.0, 4.0, 9.0]))
  np.testing.assert_allclose(held.means(command, PERIOD * np.arange(4), PERIOD), [2.0, 2.0, 2.0, 2.0 + 0.9 * 2.0])


def test_means_of_a_jittering_log_are_the_integral():
  rng = np.random.default_rng(3)
  time = np.cumsum(rng.uniform(0.002, 0.03, 300))
  command = Stream(time, rng.standard_normal(300))
  grid = time[0] + PERIOD * np.arange(int((time[-1] - time[0]) / PERIOD))
  fine = np.arange(grid[0], grid[-1] + PERIOD, 1e-5) + 5e-6
  wanted = command.at(fine[: 1000 * len(grid)]).reshape(len(grid), -1).mean(axis=1)
  np.testing.assert_allclose(held.means(command, grid, PERIOD), wanted, atol=5e-3)


@pytest.mark.parametrize("late", [0.0, 0.0034, 0.0071])
def test_the_grid_begins_where_commands_change(late):
  """Rows of a loop of 50 ms, 0.4 ms late by chance: what is left to average is a few hundredths."""
  rng = np.random.default_rng(1)
  time = 0.05 * np.arange(1, 100) + late + np.abs(rng.normal(0.0, 4e-4, 99))
  value = rng.choice([0.0, 1.0, 2.0], 99)
  run = Recording("a", {"motor_voltage": Stream(time, value), "speed": Stream(np.array([0.0, 6.0]), np.zeros(2))})
  grid, commands = run.mean_commands(PERIOD)
  assert run.start <= grid[0] < run.start + PERIOD
  between = np.abs(commands[:, 0, None] - [0.0, 1.0, 2.0]).min(axis=1)
  assert between.max() < 0.3 and between.mean() < 0.01
  zero_order = run.commands(PERIOD)
  moment = lambda t, c: float(np.sum(t[1:] * np.abs(np.diff(c[:, 0]))) / np.sum(np.abs(np.diff(c[:, 0]))))
  logged = float(np.sum(time[1:] * np.abs(np.diff(value))) / np.sum(np.abs(np.diff(value))))
  assert abs(moment(grid, commands) - logged) < PERIOD / 2  # a mean stands for the middle of its period
  assert moment(*zero_order) - logged > -1e-9


def test_rows_that_keep_to_the_grid_come_back_as_they_are():
  time = np.round(PERIOD * np.arange(500), 10)
  value = np.random.default_rng(0).standard_normal(500)
  run = Recording.from_columns("a", time, {"motor_voltage": value, "steering_command": -value, "speed": value})
  grid, commands = run.mean_commands(PERIOD)
  assert (grid == run.grid(PERIOD)).all()
  assert (commands == run.commands(PERIOD)[1]).all()


def test_a_command_that_never_changes_moves_no_grid():
  assert held.phase([Stream(np.array([0.0, 0.013]), np.ones(2))], 0.0, PERIOD) == 0.0
