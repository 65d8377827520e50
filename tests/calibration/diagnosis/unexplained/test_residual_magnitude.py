"""How much of the motion a model misses: sizes beyond the noise, on what judges, against levels."""

import copy
import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.unexplained.residual_magnitude import LEVELS, worst_relative_error


def test_what_a_model_misses_is_measured_beyond_the_noise_and_on_what_judges(clean_pool):
  base, observations = clean_pool.base, clean_pool.problem.observations
  quiet = worst_relative_error(base, clean_pool)
  assert quiet is not None and quiet.strength < 1.0
  judging = np.arange(len(observations)) >= base.n_train
  rows = observations.select("motor_speed")
  spread = max(np.std(observations.measured[rows]), 80.0)
  error = np.where(rows & judging, 0.1 * spread, 0.0)
  found = worst_relative_error(
    dataclasses.replace(base, residual=clean_pool.problem.whiten(np.hypot(error, 8.0 * rows))), clean_pool
  )
  assert found is not None and found.channel == "motor_speed" and found.share == pytest.approx(0.1, rel=1e-6)
  elsewhere = clean_pool.problem.whiten(np.where(rows & ~judging, 0.3 * spread, 0.0))
  assert worst_relative_error(dataclasses.replace(base, residual=elsewhere), clean_pool).strength < 1.0
  straight = np.where(judging, 0.0, observations.measured)  # recordings that hardly move a channel tell nothing of it
  problem = copy.copy(clean_pool.problem)
  problem.observations = dataclasses.replace(observations, measured=straight)
  pool = dataclasses.replace(clean_pool, problem=problem)
  assert worst_relative_error(dataclasses.replace(base, residual=elsewhere), pool).strength > 1.0


def test_the_level_of_what_is_missed_allows_for_the_scatter_of_the_noise(clean_pool):
  """The mean square of n values of white noise scatters by sqrt(2/n) of its variance; without noise nothing does."""
  base, observations = clean_pool.base, clean_pool.problem.observations
  asked = observations.select("motor_speed") & (np.arange(len(observations)) >= base.n_train)
  spread = max(np.std(observations.measured[observations.select("motor_speed")]), 80.0)
  off = dataclasses.replace(base, residual=clean_pool.problem.whiten(np.where(asked, 0.2 * spread, 0.0)))
  loud, quiet = (
    worst_relative_error(off, dataclasses.replace(clean_pool, floor=floor)) for floor in ({"motor_speed": 8.0}, {})
  )
  assert quiet.channel == loud.channel == "motor_speed" and quiet.level == LEVELS["motor_speed"]
  scatter = (8.0 / spread) ** 2 * np.sqrt(2.0 / asked.sum())
  assert (loud.level**2 - quiet.level**2) / scatter == pytest.approx(3.0)
