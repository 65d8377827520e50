"""Scores of fitted models: evidence, and what survives when each group of data is left out.

Leaving a group out is done on the Gauss-Newton model of each fit (Cook and Weisberg 1982, 3.2): no
further simulation. The unit is a recording, or a stretch of about ten seconds where a data set has
few recordings: neighbouring samples share their road noise and are no independent witnesses.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.decision.comparison import CAP, Comparison, standard_error
from calibration.fitting.observations import CHANNELS, Observations
from calibration.fitting.optimiser import prior_cost
from calibration.intervals.clusters import Scatter, groups_of, scatter_of

Array = NDArray[np.float64]


def held_out(model: Candidate, group: NDArray[np.int64]) -> Array:
  """Residuals of each group when the parameters are fitted to the others, (M,).

  Groups of validation values take no part in the fit, so nothing has to be left out for them.
  """
  order = np.argsort(group, kind="stable")
  edges = np.flatnonzero(np.diff(group[order])) + 1
  rows = np.split(order, edges)
  curvature, std = model.curvature, model.std
  inside = (model.values > model.free.lower + 1e-9 * std) & (model.values < model.free.upper - 1e-9 * std)
  scale = model.free.scale[inside]
  out = model.residual.copy()
  for index in rows:
    if index[0] >= model.n_train:
      continue
    part, r = model.jacobian[index][:, inside], model.residual[index]
    # the fit is taken as it stands: what its slope still promises is no gain yet
    rest = (curvature[np.ix_(inside, inside)] - part.T @ part) * np.outer(scale, scale)
    move = np.linalg.solve(rest + 1e-9 * np.eye(len(scale)), part.T @ r * scale) * scale
    # what it can't mean (a leverage point far outside the others) is not believed beyond the fit itself
    out[index] = r + part @ np.clip(move, -3.0 * std[inside], 3.0 * std[inside])
  return out


def scatter(model: Candidate, observations: Observations) -> Scatter:
  """Scatter of a fitted model's free parameters, by groups of the observations it was fitted to."""
  seen = slice(model.n_train)
  return scatter_of(model.jacobian[seen], model.residual[seen], groups_of(observations)[seen], model.free, model.values)


def clustered_std(model: Candidate, observations: Observations, directions: Array | None = None) -> Array:
  """Posterior standard deviations of a model's free parameters, (p,), or of weighed sums of them; see `Scatter.std`."""
  return scatter(model, observations).std(directions)


def compare(larger: Candidate, smaller: Candidate, observations: Observations) -> Comparison:
  """Held-out gain of a model over a smaller one, along the line that joins the two fits.

  How far to go along it is fitted to the other groups. Leaving a group out of the base parameters as
  well would add the same noise to both models, and more of it than a weak effect weighs.
  """
  found = compared(_moved(larger, smaller, observations), smaller.residual, observations.block)
  freed, drop = prior_part(smaller) - prior_part(larger), smaller.cost - larger.cost
  return dataclasses.replace(found, priors=freed, drop=drop)


def _moved(larger: Candidate, smaller: Candidate, observations: Observations) -> Array:
  """Residuals of each group as far towards the larger model as the other groups say, (M,)."""
  step, group = larger.residual - smaller.residual, groups_of(observations)
  fitted = np.arange(len(step)) < larger.n_train
  pull, power = (np.bincount(group, np.where(fitted, x, 0.0)) for x in (smaller.residual * step, step**2))
  rest = np.maximum(power.sum() - power, 1e-12)
  share = np.clip(-(pull.sum() - pull) / rest, 0.0, 2.0)
  return smaller.residual + share[group] * step


def errors_taken_off(
  larger: Candidate, smaller: Candidate, observations: Observations
) -> dict[str, tuple[float, float]]:
  """What a model takes off a smaller one's held-out error in each channel.

  Returns:
    by channel, the share of its root mean square error that is gone, negative where it grew, and Student's t of the
    blocks' gains.
  """
  moved, found = _moved(larger, smaller, observations), {}
  for index in np.unique(observations.channel):
    rows = observations.channel == index
    before, after, block = smaller.residual[rows], moved[rows], observations.block[rows]
    gain = compared(after, before, block)
    size = float(np.linalg.norm(before))
    found[CHANNELS[index]] = (1.0 - float(np.linalg.norm(after)) / size if size > 0.0 else 0.0, gain.t)
  return found


def compare_freely(larger: Candidate, smaller: Candidate, observations: Observations) -> Comparison:
  """Held-out gain when all parameters of both models are fitted to the other groups: for models with many."""
  group = groups_of(observations)
  return compared(held_out(larger, group), held_out(smaller, group), observations.block)


def compared(after: Array, before: Array, block: NDArray[np.int64]) -> Comparison:
  """Blocks' gains from held-out residuals of a larger and a smaller model, and the block of each, (M,)."""
  drop = 0.5 * (before**2 - after**2)
  gains = np.bincount(block, drop)[np.unique(block)].astype(np.float64)
  return from_blocks(gains, float(0.5 * np.sum(before**2)))


def from_blocks(gains: Array, before: float) -> Comparison:
  """Of blocks' gains, nats, (B,), and the held-out half sum of squares of the smaller model."""
  capped = np.clip(gains, -CAP, CAP)
  t = float(capped.sum()) / standard_error(capped)
  moved = np.abs(gains) > 0.02
  share = float(np.mean(gains[moved] > 0)) if moved.any() else 0.0
  return Comparison(float(capped.sum()), t, share, tuple(gains.tolist()), before)


def prior_part(model: Candidate) -> float:
  """Half the sum of squares of the priors, nats."""
  return prior_cost(model.values, model.free)
