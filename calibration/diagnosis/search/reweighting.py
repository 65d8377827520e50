"""Weights of a search: what a model explains was no noise."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate, half_square, refine, simulate
from calibration.diagnosis.pool import Pool
from calibration.fitting.likelihood import NOTICED, Problem, Weighting, weighting_from
from calibration.fitting.optimiser import prior_cost

Array = NDArray[np.float64]
_ROUNDS = 4  # of weights; each is another search from where the last one ended


def reweight_if_worth_it(pool: Pool, leaders: Callable[[Pool], Sequence[Candidate]]) -> None:
  """Take channel weights from the least that any single leaves where that tells: what is explained was no noise.

  A late pose is all that the base leaves in the displacements, and hides itself: weighed by what is left, it counts as
  their noise. What explains it has then only come as far as those weights drew it, so that it is asked again where it
  ends with the new ones.

  Args:
    pool: all models so far.
    leaders: the models of a pool that explain nearly as much as the best.
  """
  for _ in range(_ROUNDS):
    if not _reweighted(pool, leaders):
      return


def _reweighted(pool: Pool, leaders: Callable[[Pool], Sequence[Candidate]]) -> bool:
  """Whether other weights tell, and were taken.

  Where they are the same but for chance, or change no single's worth by as much as a decision hangs on, all stay, so
  that all models stand at the minimum of one and the same cost. Elsewhere the base, the best model and the other
  leaders are brought to the new one with all their columns. A leader left where it was would lose to the best for no
  other reason. They go on to their minima: where they stand, sets that contain them begin.
  """
  singles = pool.of_size(1)
  old = pool.problem.whiten(np.ones(len(pool.problem.observations)))
  weighting = _least_left(pool, [pool.base, *singles], old)
  if not _differs(pool.problem, weighting):
    return False
  ratio = pool.problem.reweighted(weighting).whiten(np.ones(len(old))) / old
  worth = [_ahead(model, pool.base, ratio) for model in singles]
  changes = [abs(new - (pool.base.cost - model.cost)) for model, new in zip(singles, worth, strict=True)]
  if max(changes, default=0.0) < NOTICED or max(worth) <= 0.0:
    return False
  best = singles[int(np.argmax(worth))]
  _reweight(pool, pool.problem.at(best.theta).reweighted(weighting), ratio)
  near = list({id(m): m for m in [best, *leaders(pool)]}.values())
  refine(pool.problem, [pool.base, *near], 1, full=True)
  refine(pool.problem, near, 1, full=True)
  refine(pool.problem, near, 2)
  return True


def _differs(problem: Problem, weighting: Weighting) -> bool:
  """Whether any channel's deviation differs from the present one by more than a sample's own does by chance.

  That of n witnesses errs by 1 / sqrt(2 n) of it (Kendall and Stuart, The Advanced Theory of Statistics 1, ch. 10).
  """
  counts = np.bincount(problem.observations.channel[: problem.n_train], minlength=len(weighting.std))
  witnesses = np.maximum(counts / problem.weighting.correlation, 1.0)
  change = np.abs(np.log(weighting.std / problem.weighting.std))
  return bool(np.any(change * np.sqrt(2.0 * witnesses) > 1.0))


def _least_left(pool: Pool, models: Sequence[Candidate], old: Array) -> Weighting:
  """Weights of every channel from the model that leaves least of it; `old`, (M,): those of the residuals."""
  observations = pool.problem.observations
  each = [weighting_from(observations, model.residual / old, pool.floor) for model in models]
  std = np.stack([weighting.std for weighting in each])
  least = np.argmin(np.nan_to_num(std, nan=np.inf), axis=0)
  spike = np.stack([weighting.spike for weighting in each])[least[observations.channel], np.arange(len(observations))]
  return dataclasses.replace(each[0], std=std[least, np.arange(len(least))], spike=spike)


def _ahead(model: Candidate, base: Candidate, ratio: Array) -> float:
  """Nats that a model is ahead of the base under other weights, both left where they are."""
  part = slice(0, model.n_train)
  gain = half_square(base.residual[part] * ratio[part]) - half_square(model.residual[part] * ratio[part])
  return gain + prior_cost(base.values, base.free) - prior_cost(model.values, model.free)


def _reweight(pool: Pool, problem: Problem, ratio: Array) -> None:
  """Other weights; known residuals, Jacobians and signatures are rescaled.

  A surrogate that was put right at the best model is simulated anew: from there the search goes on.
  """
  models = list(pool.models.values())
  if problem.twin is not pool.problem.twin:
    simulate(problem, models)
  else:
    for model in models:
      model.residual = model.residual * ratio
  pool.problem = problem
  for model in models:
    model.jacobian = model.jacobian * ratio[:, None]
    model.settled = False
  pool.signatures = {
    n: dataclasses.replace(s, direction=(s.direction * ratio[: len(s.direction)]).astype(np.float32))
    for n, s in pool.signatures.items()
  }
