"""Weights of a search: what the best model explains was no noise."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate, half_square, refine, simulate
from calibration.diagnosis.pool import Pool
from calibration.fitting.likelihood import Problem, weighting_from
from calibration.fitting.optimiser import prior_cost
from calibration.fitting.recalibration import NOTICED

Array = NDArray[np.float64]


def reweight_if_worth_it(pool: Pool, near: Sequence[Candidate]) -> None:
  """Take channel weights from the best single where that tells: what it explains was no noise.

  A late pose is all that the base leaves in the displacements, and hides itself: weighed by what is left, it counts as
  their noise. Where the new weights would change what the best single is worth by less than a decision hangs on, all
  stay as they were, so that all models stand at the minimum of one and the same cost. Elsewhere the base, the best
  model and the other leaders are brought to the new one with all their columns. A leader left where it was would lose
  to the best for no other reason. They go on to their minima: where they stand, sets that contain them begin.

  Args:
    pool: all models so far.
    near: models that explain nearly as much as the best.
  """
  best = pool.best(pool.of_size(1))
  if best is pool.base:
    return
  problem, ratio = _weighed_by(pool, best)
  if abs(_ahead(best, pool.base, ratio) - (pool.base.cost - best.cost)) < NOTICED:
    return
  leaders = list({id(m): m for m in [best, *near]}.values())
  _reweight(pool, problem, ratio)
  refine(pool.problem, [pool.base, *leaders], 1, full=True)
  refine(pool.problem, leaders, 1, full=True)
  refine(pool.problem, leaders, 2)


def _weighed_by(pool: Pool, best: Candidate) -> tuple[Problem, Array]:
  """The problem with weights from a model's residuals, put right by MuJoCo there; factors to them, (M,)."""
  problem = pool.problem.at(best.theta)
  old = problem.whiten(np.ones(len(problem.observations)))
  problem = problem.reweighted(weighting_from(problem.observations, best.residual / old, pool.floor))
  return problem, problem.whiten(np.ones(len(problem.observations))) / old


def _ahead(best: Candidate, base: Candidate, ratio: Array) -> float:
  """Nats that a model is ahead of the base under other weights, both left where they are."""
  part = slice(0, best.n_train)
  gain = half_square(base.residual[part] * ratio[part]) - half_square(best.residual[part] * ratio[part])
  return gain + prior_cost(base.values, base.free) - prior_cost(best.values, best.free)


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
