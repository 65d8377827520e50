"""MuJoCo's word on models that were searched for on the reduced car.

Where a surrogate searched, a model's estimates are where the surrogate's cost is lowest, and its residual is the
surrogate's. Before anything is decided, the models a decision can rest on get MuJoCo's residual, and the best of them
is fitted on from there with the surrogate put right at its own estimates, as far as MuJoCo confirms it.
"""

import copy
from collections.abc import Sequence

from calibration.diagnosis.candidates import Candidate, promise, refine, simulate
from calibration.diagnosis.pool import Pool
from calibration.fitting.likelihood import Problem

_ROUNDS = 3  # corrections of one model, and of which model is the best
_SETTLED = 1.0  # nats: what a correction must promise, and bring, to be followed by another
_NEAR = 30.0  # nats behind the best model within which the others are confirmed
_SINGLES = 3  # that are confirmed whatever they bring


def confirm_best(pool: Pool) -> None:
  """Confirm what a decision may rest on: closely the recalibrated twin and the best model; and the best model's
  subsets, those that come near it, and the best singles.

  The pool's problem is put right at the best model afterwards.
  """
  if pool.problem.exact is pool.problem:
    return
  for _ in range(_ROUNDS):
    best = pool.best(list(pool.models.values()))
    if best.corrected and pool.base.corrected:
      break
    confirm(pool, closely=[pool.base, best])
    singles = pool.foremost(1, _SINGLES)
    subset = lambda key, best=best: key < frozenset(best.mechanisms)
    near = [m for key, m in pool.models.items() if m.cost < best.cost + _NEAR or subset(key)]
    confirm(pool, [*near, *singles])
  best = pool.best(list(pool.models.values()))
  pool.problem = pool.problem.at(best.theta)


def confirm(pool: Pool, models: Sequence[Candidate] = (), closely: Sequence[Candidate] = ()) -> None:
  """Give models MuJoCo's residuals.

  Args:
    pool: their problem, with the models in it.
    models: changed in place; those confirmed already are left as they are.
    closely: models that are fitted on, too, until MuJoCo's own cost settles.
  """
  if pool.problem.exact is pool.problem:
    return
  for model in closely:
    if not model.corrected:
      correct(pool.problem, model)
  waiting = list({id(m): m for m in models if not m.confirmed}.values())
  simulate(pool.problem.exact, waiting)
  for model in waiting:
    model.confirmed = True
  _nest(pool)


def correct(problem: Problem, model: Candidate) -> None:
  """Fit a model on to where MuJoCo's cost is lowest, in place; its residual is MuJoCo's afterwards."""
  here = problem.at(model.theta)
  simulate(here, [model])
  for _ in range(_ROUNDS):
    if promise(model) < _SETTLED:
      break
    trial = copy.copy(model)
    trial.jacobian, trial.settled = model.jacobian.copy(order="K"), False
    refine(here, [trial], 1, full=True)
    promised = model.cost - trial.cost
    if promised >= _SETTLED:
      here = problem.at(trial.theta)
      simulate(here, [trial])
    model.jacobian = trial.jacobian
    if promised < _SETTLED or trial.cost >= model.cost:
      break
    model.theta, model.values, model.residual = trial.theta, trial.values, trial.residual
  model.confirmed = model.corrected = True


def _nest(pool: Pool) -> None:
  """No set fits worse than its subsets that MuJoCo has seen: where it does, it takes their estimates over.

  One that MuJoCo has not seen, too: it stands where its subset stood before that was corrected.
  """
  for key in sorted(filter(None, pool.models), key=len):
    smaller = [m for k, m in pool.models.items() if k < key and m.confirmed]
    parent, model = min(smaller, key=lambda m: m.cost, default=None), pool.models[key]
    if parent is not None and model.cost > parent.cost:
      pool.models[key] = pool.not_worse(model, parent)
      pool.models[key].confirmed, pool.models[key].corrected = True, parent.corrected
