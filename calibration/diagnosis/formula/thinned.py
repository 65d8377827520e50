"""The part of the driving that a force is sought in: what is fitted, and of a long log as much as there is time for."""

import copy
import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.fitting.likelihood import Problem
from calibration.fitting.windows import spread_evenly

MOST = 130.0  # s of driving: all stages on one core then take the half minute that is promised


def thinned(problem: Problem, model: Candidate, most: float = MOST, judges: bool = False) -> tuple[Problem, Candidate]:
  """The fitted stretches, evenly spread where they are more than `most` seconds, and the model on them.

  Args:
    problem: residuals.
    model: fitted to it.
    most: s of fitted driving.
    judges: as large a share of the stretches that only judge is kept, too; else none.
  """
  observations = problem.observations
  segments, stretch = observations.stretches.segments, observations.stretch
  fitted, judging = np.unique(stretch[: model.n_train]), np.unique(stretch[model.n_train :])
  share = min(1.0, most / max(float(segments.steps[fitted].sum()) * segments.period, 1e-9))
  kept = np.concatenate([_share(fitted, share), _share(judging, share if judges else 0.0)])
  rows = np.flatnonzero(np.isin(stretch, kept))
  weighting = dataclasses.replace(problem.weighting, spike=problem.weighting.spike[rows])
  n_train = int(np.sum(rows < model.n_train))
  part = Problem(problem.twin, observations.some(kept), weighting, n_train, problem.base)
  small = copy.copy(model)
  small.residual, small.jacobian, small.n_train = model.residual[rows], model.jacobian[rows], n_train
  return part, small


def _share(stretches: NDArray[np.intp], share: float) -> NDArray[np.intp]:
  """A share of stretches, evenly spread; one at least of any, none of none."""
  room = max(1, int(len(stretches) * share)) if share and len(stretches) else 0
  return stretches[spread_evenly(len(stretches), room, 0.5)] if room else stretches[:0]
