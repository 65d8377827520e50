"""Weights of a search: an effect that is all that the base leaves in a channel is no noise of it."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.search.reweighting import _differs, reweight_if_worth_it
from calibration.fitting.likelihood import weighting_from
from calibration.fitting.residual_channels import CHANNELS

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


def test_what_had_come_half_way_is_asked_again_where_it_ends(offset_pool):
  """Weighed by what a half-fitted offset leaves, the rest of it would stay the noise that it is taken for."""
  pool = weighed_by_the_base(offset_pool)
  fitted = pool.models[KEY]
  raw = pool.problem.raw(fitted.theta[None])[0]
  place = fitted.free.index("steering_offset")
  half = dataclasses.replace(fitted, theta=fitted.theta.copy(), values=fitted.values.copy(), settled=False)
  half.values[place] = half.theta[pool.problem.parameters.index("steering_offset")] = 0.5 * fitted.values[place]
  half.residual = pool.problem.residual(half.theta[None])[0]
  pool.models[KEY] = half
  reweight_if_worth_it(pool, lambda pool: [])
  wanted = weighting_from(pool.problem.observations, raw, pool.floor).std
  np.testing.assert_allclose(pool.problem.weighting.std, wanted, rtol=0.03)


@pytest.mark.parametrize("errors", [0.7, -0.7, 1.4, -1.4])
def test_a_deviation_differs_beyond_its_own_error(offset_pool, errors):
  """Of n witnesses it is known to 1 / sqrt(2 n)."""
  problem, index = offset_pool.problem, CHANNELS.index("yaw_rate")
  rows = problem.observations.channel[: problem.n_train] == index
  std = problem.weighting.std.copy()
  std[index] *= np.exp(errors / np.sqrt(2.0 * np.sum(rows) / problem.weighting.correlation[index]))
  assert _differs(problem, dataclasses.replace(problem.weighting, std=std)) == (abs(errors) > 1.0)


def test_weights_stay_where_nothing_hangs_on_them(clean_pool):
  pool = dataclasses.replace(clean_pool, models=dict(clean_pool.models))
  before = {key: m.cost for key, m in pool.models.items()}
  reweight_if_worth_it(pool, lambda pool: [])
  assert pool.problem is clean_pool.problem
  assert {key: m.cost for key, m in pool.models.items()} == pytest.approx(before)


def test_what_any_single_explains_of_a_channel_is_no_noise_of_it(offset_pool):
  """The offset shows in the yaw rate; another name explains more, of the motor's speed."""
  pool = weighed_by_the_base(dataclasses.replace(offset_pool, floor={}))
  speed = pool.problem.observations.channel == CHANNELS.index("motor_speed")
  better = dataclasses.replace(pool.base, mechanisms=("quadratic_drag",))
  better.residual = np.where(speed, 0.3 * pool.base.residual, pool.base.residual)
  pool.models[frozenset(better.mechanisms)] = better
  assert better.cost < pool.models[KEY].cost
  before, by = pool.problem.weighting.std, {c: CHANNELS.index(c) for c in ("motor_speed", "yaw_rate")}
  reweight_if_worth_it(pool, lambda pool: [])
  after = pool.problem.weighting.std
  assert after[by["motor_speed"]] == pytest.approx(0.3 * before[by["motor_speed"]], rel=0.05)
  assert after[by["yaw_rate"]] < 0.9 * before[by["yaw_rate"]]
