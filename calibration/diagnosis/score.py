"""Scores of fitted models: evidence, and what survives when each group of data is left out.

Leaving a group out is done on the Gauss-Newton model of each fit (Cook and Weisberg 1982, 3.2): no
further simulation. The unit is a recording, or a stretch of about ten seconds where a data set has
few recordings: neighbouring samples share their road noise and are no independent witnesses.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.observations import CHANNELS, Observations

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Comparison:
  """A model against a smaller one.

  Attributes:
    gain: held-out drop of half the sum of squares, nats.
    t: mean over spread of the groups' gains times the root of their number.
    share_positive: groups that gained, 0 to 1, among those whose prediction moved at all.
    groups: gain per group, (G,).
  """

  gain: float
  t: float
  share_positive: float
  groups: Array


def groups_of(observations: Observations, least: int = 8, length: float = 10.0) -> NDArray[np.int64]:
  """Group number of every value, (M,): recordings, or stretches of `length` s where those are few."""
  if len(observations.names) >= least:
    return observations.recording
  stretch = observations.recording * 100_000 + (observations.time // length).astype(np.int64)
  return np.unique(stretch, return_inverse=True)[1].reshape(-1)


def held_out(model: Candidate, group: NDArray[np.int64]) -> Array:
  """Half the sum of squares of each group when the parameters are fitted to the others, (G,)."""
  order = np.argsort(group, kind="stable")
  edges = np.flatnonzero(np.diff(group[order])) + 1
  rows = np.split(order, edges)
  gradient = model.jacobian.T @ model.residual + (model.values - model.free.nominal) / model.free.std**2
  curvature = model.curvature
  scale = model.free.scale
  out = np.empty(len(rows))
  for k, index in enumerate(rows):
    part, r = model.jacobian[index], model.residual[index]
    rest = (curvature - part.T @ part) * np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
    move = -np.linalg.solve(rest, (gradient - part.T @ r) * scale) * scale
    # a linear model is trusted within three standard deviations of the fit only
    move = np.clip(move, model.free.lower - model.values, model.free.upper - model.values)
    changed = r + part @ move
    out[k] = 0.5 * float(changed @ changed)
  return out


def compare(larger: Candidate, smaller: Candidate, group: NDArray[np.int64]) -> Comparison:
  """Held-out gain of a model over a smaller one."""
  gains = held_out(smaller, group) - held_out(larger, group)
  moved = np.abs(gains) > 0.02
  count = len(gains)
  spread = float(np.std(gains, ddof=1)) if count > 1 else np.inf
  t = float(np.mean(gains) / (spread + 1e-12) * np.sqrt(count)) if count > 1 else 0.0
  share = float(np.mean(gains[moved] > 0)) if moved.any() else 0.0
  return Comparison(float(gains.sum()), t, share, gains)


def evidence(larger: Candidate, smaller: Candidate, observations: Observations) -> float:
  """Log profile likelihood ratio with unknown channel variances, nats: sum_c n_c / 2 log(S0_c / S1_c), plus priors."""
  total = prior_part(smaller) - prior_part(larger)
  for index in np.unique(observations.channel):
    rows = observations.channel == index
    before = float(np.sum(smaller.residual[rows] ** 2))
    after = float(np.sum(larger.residual[rows] ** 2))
    total += 0.5 * before * np.log(before / after) if before > 0 and after > 0 else 0.0
  return total


def prior_part(model: Candidate) -> float:
  """Half the sum of squares of the priors, nats."""
  return 0.5 * float(np.sum(((model.values - model.free.nominal) / model.free.std) ** 2))


def channel_shares(larger: Candidate, smaller: Candidate, observations: Observations) -> dict[str, float]:
  """Share of the drop in half the sum of squares each channel brings; negative shares are set to zero."""
  drop = smaller.residual**2 - larger.residual**2
  sums = {CHANNELS[i]: max(float(drop[observations.channel == i].sum()), 0.0) for i in np.unique(observations.channel)}
  total = sum(sums.values()) or 1.0
  return {name: value / total for name, value in sorted(sums.items(), key=lambda kv: -kv[1])}


def best_of(models: Sequence[Candidate], base: Candidate, group: NDArray[np.int64]) -> Candidate:
  """The model with the largest held-out gain over the base."""
  reference = held_out(base, group).sum()
  return max(models, key=lambda m: reference - held_out(m, group).sum(), default=base)
