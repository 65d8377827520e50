"""The part of the driving that a force is sought in: what is fitted, and of a long log as much as there is time for."""

import copy
import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.fitting.likelihood import Problem

MOST = 130.0  # s of driving: all stages on one core then take the half minute that is promised


def thinned(problem: Problem, model: Candidate, most: float = MOST) -> tuple[Problem, Candidate]:
  """The fitted stretches alone, evenly spread where they are more than `most` seconds, and the model on them."""
  observations = problem.observations
  segments = observations.stretches.segments
  fitted = np.unique(observations.stretch[: model.n_train])
  seconds = float(segments.steps[fitted].sum()) * segments.period
  room = max(1, int(len(fitted) * min(1.0, most / max(seconds, 1e-9))))
  kept: NDArray[np.intp] = fitted[((np.arange(room) + 0.5) * len(fitted) / room).astype(int)]
  rows = np.flatnonzero(np.isin(observations.stretch, kept))
  weighting = dataclasses.replace(problem.weighting, spike=problem.weighting.spike[rows])
  part = Problem(problem.twin, observations.some(kept), weighting, len(rows), problem.base)
  small = copy.copy(model)
  small.residual, small.jacobian, small.n_train = model.residual[rows], model.jacobian[rows], len(rows)
  return part, small
