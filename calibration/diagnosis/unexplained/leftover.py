"""What a model leaves over: structure in its residuals that noise would not have, whatever physics made it.

Three kinds are looked for, and none needs a simulation. *Smooth*: the residual of a channel as a function of a few
circumstances (motion, commands and their past, heading, place, what went before), fitted by ridge regression to all
groups of data but one and judged on that one. *Rhythmic*: a line in its spectrum, over time or over turns of the
wheels, which no function of circumstances can follow because its phase is nobody's. *Bursts*: moments that come of
themselves and hold most of what is left.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.circumstances import at_values
from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.structure import Leftover
from calibration.diagnosis.score import compared
from calibration.diagnosis.unexplained.bursts import bursts
from calibration.diagnosis.unexplained.families import heading, histories, motion, past_commands, places
from calibration.diagnosis.unexplained.rhythm import strongest_line
from calibration.fitting.likelihood import Problem
from calibration.fitting.observations import Observations
from calibration.fitting.residual_channels import RESIDUALS
from calibration.intervals.clusters import groups_of
from qcar_twin.plant import Prediction

Array = NDArray[np.float64]

# circumstances offered, and what the report says they are
FAMILIES: dict[str, tuple[Callable[[Observations, Prediction], Array], tuple[str, ...]]] = {
  "motion": (motion, ("speed", "yaw_rate", "accel_x", "accel_y")),
  "commands": (past_commands, ("drive_command", "steering_command", "their past 0.4 s")),
  "heading": (heading, ("pose_yaw",)),
  "place": (places, ("pose_x", "pose_y")),
  "history": (histories, ("sliding and driving of the last seconds", "accel_x", "accel_y")),
}
_USUAL = 0.1  # size of a coefficient in standard deviations of what the channel measured


def leftovers(model: Candidate, problem: Problem, prediction: Prediction) -> list[Leftover]:
  """Everything a model leaves over, per channel and family.

  Args:
    model: fitted, with the problem's weights.
    problem: what was measured and how it is weighed.
    prediction: the model's signals, one vector.
  """
  observations, found = problem.observations, []
  whitening = problem.whiten(np.ones(len(observations)))
  for family, (features, depends_on) in FAMILIES.items():
    grid = features(observations, prediction)
    for channel in observations.present if grid.shape[-1] else ():
      test = smooth_gain(model.residual, at_values(grid, observations, channel), observations, channel, whitening)
      # one recording left out that lies far from all others may be foretold so badly that the total is negative
      nats, count = max(test.total, test.gain), len(test.blocks)
      size = _size(2.0 * nats, observations, channel, whitening)
      found.append(Leftover(channel, family, depends_on, test.gain / max(count, 1), test.t, count, size))
  turns = problem.twin.vehicle.gear_ratio / (2.0 * np.pi)
  for channel in observations.present:
    if RESIDUALS[channel].is_direct:
      line = strongest_line(model.residual, observations, prediction, channel, turns)
      size = _size(line.mean_square * np.count_nonzero(observations.select(channel)), observations, channel, whitening)
      found.append(Leftover(channel, "rhythm", line.depends_on, line.nats, None, line.stretches, size))
      # a pose that jumps is mostly the fault of what measures it
      burst = bursts(model.residual, observations, prediction, channel)
      size = _size(burst.sum_of_squares, observations, channel, whitening)
      found.append(Leftover(channel, "bursts", burst.depends_on, burst.odds, None, burst.windows, size))
  return found


def _size(sum_of_squares: float, observations: Observations, channel: str, whitening: Array) -> float:
  """RMS of a structure from its whitened sum of squares, as a share of what the channel's measured values spread."""
  rows = observations.select(channel)
  rms = np.sqrt(max(sum_of_squares, 0.0) / np.sum(whitening[rows] ** 2))
  return float(rms / max(np.std(observations.measured[rows]), 1e-12))


def smooth_gain(
  residual: Array, features: Array, observations: Observations, channel: str, whitening: Array
) -> Comparison:
  """Held-out gain of a ridge regression of one channel's residual on features (k, F).

  A coefficient's prior deviation is a tenth of what the channel's measured values spread.

  Args:
    residual: of all values, (M,), whitened.
    features: at the channel's values.
    observations, channel: what was measured.
    whitening: factor from each value's unit to nats, (M,).
  """
  rows = np.flatnonzero(observations.select(channel))
  target, group = residual[rows], groups_of(observations)[rows]
  columns = features * (_USUAL * float(np.std(observations.measured[rows])) * whitening[rows])[:, None]
  members = [np.flatnonzero(group == kind) for kind in np.unique(group)]
  grams = np.stack([columns[m].T @ columns[m] for m in members])
  pulls = np.stack([columns[m].T @ target[m] for m in members])
  gram, pull, after = grams.sum(axis=0) + np.eye(columns.shape[1]), pulls.sum(axis=0), target.copy()
  for own, own_pull, member in zip(grams, pulls, members, strict=True):
    after[member] -= columns[member] @ np.linalg.solve(gram - own, pull - own_pull)
  return compared(after, target, observations.block[rows])
