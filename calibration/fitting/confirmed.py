"""Whether MuJoCo confirms a step that a surrogate led, and where it does not."""

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.likelihood import Problem
from calibration.fitting.surrogate import Stretch

Array = NDArray[np.float64]

NOTICED = 10.0  # nats: no decision hangs on a smaller error; hardly a claim rests on twice as many
# of a predicted reduction: below, a model is not trusted over that step (Nocedal and Wright, 2nd ed., algorithm 4.1)
_TRUSTED = 0.25


def misled(problem: Problem, anchor: Array, tried: Array) -> list[Stretch]:
  """The fewest stretches without which MuJoCo confirms a surrogate's step from its anchor, full parameters, (P,).

  Or without which what it denies is too little to be noticed: near a minimum a prediction is a small difference of what
  the stretches gain and lose, and hardly any of them could be trusted.
  """
  stretch, segments = problem.observations.stretch[: problem.n_train], problem.observations.stretches.segments
  nats = lambda p, theta: np.bincount(stretch, 0.5 * p.fitted_residual(theta[None])[0] ** 2)
  before = nats(problem, anchor)
  predicted, actual = before - nats(problem, tried), before - nats(problem.exact, tried)
  order = np.argsort(actual - predicted)
  leads = lambda rest: trusted(predicted[rest].sum(), actual[rest].sum())
  count = next(k for k in range(1, len(order) + 1) if leads(order[k:]))
  return [(segments.recording[k], float(segments.offset[k])) for k in order[:count]]


def trusted(predicted: float, actual: float) -> bool:
  """Whether a surrogate led well: the actual reduction is enough of the predicted one, nats, or nearly it."""
  return actual >= _TRUSTED * predicted or predicted - actual <= NOTICED
