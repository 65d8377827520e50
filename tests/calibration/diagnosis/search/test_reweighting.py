"""Weights of a search: an effect that is all that the base leaves in a channel is no noise of it."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.search.reweighting import reweight_if_worth_it
from calibration.fitting.likelihood import weighting_from

KEY = frozenset(["steering_offset"])


def weighed_by_the_base(pool):
  """The same pool with weights from the base's residuals, as a search begins."""
  ones = np.ones(len(pool.problem.observations))
  old = pool.problem.whiten(ones)
  problem = pool.problem.reweighted(weighting_from(pool.problem.observations, pool.base.residual / old, pool.floor))
  ratio = problem.whiten(ones) / old
  rescaled = lambda m: dataclasses.replace(m, residual=m.residual * ratio, jacobian=m.jacobian * ratio[:, None])
  models = {key: rescaled(m) for key, m in pool.models.items() if key in (frozenset(), KEY)}
  cut = lambda s: (s.direction * ratio[: len(s.direction)]).astype(np.float32)
  signatures = {n: dataclasses.replace(s, direction=cut(s)) for n, s in pool.signatures.items()}
  return dataclasses.replace(pool, problem=problem, models=models, signatures=signatures)


def test_what_the_best_single_explains_stops_counting_as_noise(offset_pool):
  pool = weighed_by_the_base(offset_pool)
  hidden = pool.base.cost - pool.models[KEY].cost
  reweight_if_worth_it(pool, lambda pool: [])
  assert pool.base.cost - pool.models[KEY].cost > 1.3 * hidden
  residual = pool.problem.fitted_residual(pool.models[KEY].theta[None])[0]
  np.testing.assert_allclose(pool.models[KEY].residual[: pool.base.n_train], residual, atol=1e-9)


def test_weights_stay_where_nothing_hangs_on_them(clean_pool):
  pool = dataclasses.replace(clean_pool, models=dict(clean_pool.models))
  before = {key: m.cost for key, m in pool.models.items()}
  reweight_if_worth_it(pool, lambda pool: [])
  assert pool.problem is clean_pool.problem
  assert {key: m.cost for key, m in pool.models.items()} == pytest.approx(before)
