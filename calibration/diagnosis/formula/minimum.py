"""What a force is sought in: a model at the minimum of its cost, on as much of the driving as there is time for."""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.fitting.likelihood import NOTICED, Problem
from calibration.fitting.recalibration import descended
from calibration.fitting.surrogate import Surrogate
from calibration.fitting.windows import spread_evenly
from qcar_twin.plant import Segments
from qcar_twin.twin.twin import Twin

MOST = 130.0  # s of driving: all stages on one core then take the half minute that is promised


def at_minimum(problem: Problem, model: Candidate) -> tuple[Problem, Candidate]:
  """A model where its cost is lowest, by the recalibration's descent, and the problem put right there.

  Wheels that slip make the cost rough, so a few Gauss-Newton steps end far from its minimum. All free parameters move,
  the base's and the formula's alike. MuJoCo's corrections end where they promise less than a decision would notice, or
  where it confirms them no more: columns in MuJoCo would take many times as long as a formula is worth.

  Args:
    problem: with the model's mechanisms.
    model: what is free, and where it begins.

  Raises:
    NotFinite: a simulation on the way.
  """
  theta = problem.embed(model.free.names, model.values, problem.parameters.nominal)[0]
  problem, minimum = descended(problem.at(theta), model.free, model.values, NOTICED, guard=False)
  theta = problem.embed(model.free.names, minimum.theta, problem.parameters.nominal)[0]
  problem = problem.at(theta)
  jacobian = np.zeros((len(problem.observations), len(model.free)))
  jacobian[: model.n_train] = minimum.jacobian
  found = dataclasses.replace(
    model, theta=theta, values=minimum.theta.copy(), residual=problem.residual(theta[None])[0], jacobian=jacobian,
    settled=True, validation_current=True, confirmed=True, corrected=True,
  )  # fmt: skip
  return problem, found


def thinned(problem: Problem, model: Candidate, most: float = MOST, judges: bool = False) -> tuple[Problem, Candidate]:
  """The fitted stretches, evenly spread where they are more than `most` seconds, and the model on them.

  Stretches in which the reduced car was found to lead a search astray are left out: what a push does there is read off
  that car, and what it does in MuJoCo, a car near its limit of balance say, is no sum of pushes.

  Args:
    problem: residuals.
    model: fitted to it.
    most: s of fitted driving.
    judges: as large a share of the stretches that only judge is kept, too; else none.
  """
  observations = problem.observations
  segments, stretch = observations.stretches.segments, observations.stretch
  fitted, judging = _led(problem.twin, segments, [np.unique(s) for s in np.split(stretch, [model.n_train])])
  share = min(1.0, most / max(float(segments.steps[fitted].sum()) * segments.period, 1e-9))
  kept = np.concatenate([_share(fitted, share), _share(judging, share if judges else 0.0)])
  rows = np.flatnonzero(np.isin(stretch, kept))
  weighting = dataclasses.replace(problem.weighting, spike=problem.weighting.spike[rows])
  n_train = int(np.sum(rows < model.n_train))
  part = Problem(problem.twin, observations.some(kept), weighting, n_train, problem.base)
  small = copy.copy(model)
  small.residual, small.jacobian, small.n_train = model.residual[rows], model.jacobian[rows], n_train
  return part, small


def _led(twin: Twin, segments: Segments, among: Sequence[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
  """Those of some stretches that the reduced car may be trusted in; all where it may in none of them."""
  if not isinstance(twin, Surrogate):
    return list(among)
  led = np.flatnonzero(~twin.left(segments))
  return [kept if (kept := np.intersect1d(some, led)).size else some for some in among]


def _share(stretches: NDArray[np.intp], share: float) -> NDArray[np.intp]:
  """A share of stretches, evenly spread; one at least of any, none of none."""
  room = max(1, int(len(stretches) * share)) if share and len(stretches) else 0
  return stretches[spread_evenly(len(stretches), room, 0.5)] if room else stretches[:0]
