"""The joint minimum over parameters, window starts and noise: Gauss-Newton with relinearised windows.

A linearisation costs a simulation per parameter, start state and force. Chord steps that reuse it cost one each.
"""

import dataclasses
import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from calibration.likelihood.linear import Place, Whitened
from calibration.likelihood.noise import FITTED, Noise
from calibration.likelihood.readings import Readings
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

SETTLED = 0.5  # nats per linearisation below which a minimum is reached
_STEP = 0.1  # of a parameter's scale, over which slopes are taken
_LARGEST = 0.5  # m/s, rad/s, m or rad by which a start moves in a step at most
_TURNS, _CHORD, _HALVINGS = 2, 3, 4
_SHARES = (1.0, 0.4, 0.1, 0.0)  # of the starts' shift that each recording chooses from
_NOISE_PRIOR = 1.0  # standard deviation of the logarithm of the forces' memory about its start


@dataclasses.dataclass(frozen=True)
class Minimum:
  """Where a refit ended.

  Attributes:
    free: fitted parameters with their priors, p of them; theta: all parameters, (P,); starts: motions, (J, 7).
    noise: fitted with them.
    cost: minus the log posterior up to a constant that all models share, nats.
    place: linearisation there; white: residual and the free parameters' columns whitened there.
    precision: posterior precision, (p, p).
    simulations: of the data that were spent.  settled: whether the last linearisation brought less than SETTLED.
  """

  free: ParameterSet
  theta: Array
  starts: Array
  noise: Noise
  cost: float
  place: Place
  white: Whitened
  precision: Array
  simulations: int
  settled: bool

  @property
  def values(self) -> Array:
    return self.theta[self.place_index]

  @property
  def place_index(self) -> NDArray[np.intp]:
    return indices(self.place.twin, self.free)

  @property
  def std(self) -> Array:
    return np.sqrt(np.diag(np.linalg.inv(self.precision)))


def indices(twin: Twin, free: ParameterSet) -> NDArray[np.intp]:
  """Where parameters stand in the twin's vector."""
  return np.array([twin.parameters.index(name) for name in free.names], dtype=np.intp)


def moved(place: Place, parameters: Sequence[Parameter], step: float = _STEP) -> tuple[Array, Array]:
  """Vectors (p, P) that differ from a place in a parameter each, and by how much, (p,)."""
  theta, moves = np.repeat(place.theta[None], len(parameters), axis=0), np.empty(len(parameters))
  for k, p in enumerate(parameters):
    i = place.twin.parameters.index(p.name)
    move = step * p.scale
    moves[k] = move if theta[k, i] + move <= p.upper else -move
    theta[k, i] += moves[k]
  return theta, moves


def prior_of(free: ParameterSet, values: Array) -> Array:
  """Deviations of values from their priors, in standard deviations, (p,)."""
  return (values - free.nominal) / free.std


def fit_noise(place: Place, noise: Noise, evaluations: int) -> Noise:
  """The noise that makes a residual most likely, from what it was or from where all fits begin."""
  low, high = (np.log([FITTED[n][k] for n in FITTED]) for k in (1, 2))
  begun = np.log([FITTED[n][0] for n in FITTED])
  memory = list(FITTED).index("memory")

  def cost(fitted: Array) -> float:
    inside = np.clip(fitted, low, high)
    white, _ = place.whiten(dataclasses.replace(noise, fitted=inside), place.residual, place.gap, place.starts)
    out = white.cost + 0.5 * ((inside[memory] - begun[memory]) / _NOISE_PRIOR) ** 2
    return out if np.isfinite(out) else 1e12

  start = min((noise.fitted, begun), key=cost)
  bounds = list(zip(low, high, strict=True))
  options = {"maxfun": evaluations, "eps": 0.02, "ftol": 1e-9, "gtol": 0.1}
  found = minimize(cost, start, method="L-BFGS-B", bounds=bounds, options=options)
  better = found.x if found.fun < cost(start) else start
  return dataclasses.replace(noise, fitted=np.clip(better, low, high))


def refit(
  twin: Twin, readings: Readings, noise: Noise, free: ParameterSet, theta: Array, starts: Array,
  steps: int = 6, evaluations: Sequence[int] = (120, 60, 40), place: Place | None = None,
  columns: tuple[Array, Array] | None = None, trusting: int = 2, settled_at: float = SETTLED,
  brief: bool = False,
) -> Minimum:  # fmt: skip
  """Fit free parameters, starts and noise from given ones.

  Args:
    steps: linearisations at most.
    evaluations: of the noise's likelihood in each linearisation, the last for all further ones; 0 to keep it.
    place, columns: of the first linearisation, where they are known.
    brief: whether slopes of the last linearisation do for what is said of the minimum.
    settled_at: nats that a linearisation must bring to be followed by another.
    trusting: linearisations before residuals say which windows are trusted less.
  """
  spent, settled = 0, False
  for step in range(steps):
    here = place if step == 0 and place is not None else Place(twin, readings, noise, theta, starts)
    made = columns if step == 0 and columns is not None else here.columns(*moved(here, list(free)))
    spent, gained = spent + 12 + len(free), 0.0
    for turn in range(_TURNS if step >= trusting else 1):
      if step >= trusting:
        noise = heeding(here, noise)
        made = here.reweighted(noise, *made)
        here = here.under(noise)
      tries = evaluations[min(step, len(evaluations) - 1)] if turn == 0 else evaluations[-1] // 2
      noise = fit_noise(here, noise, tries) if tries else noise
      theta, starts, down, more = _descend(here, noise, free, theta, starts, made)
      gained, spent = gained + down, spent + more
      if down > 0.0:
        here = here.towards(theta, starts)
      if down < SETTLED:
        break
    log.info("linearisation %d: %.1f nats down", step, gained)
    if gained < settled_at:
      settled = True
      break
  if brief:
    return _concluded(here, made, noise, free, spent, settled)
  return conclude(twin, readings, noise, free, theta, starts, spent, settled)


def conclude(
  twin: Twin, readings: Readings, noise: Noise, free: ParameterSet, theta: Array, starts: Array, spent: int,
  settled: bool,
) -> Minimum:  # fmt: skip
  """The minimum with its slopes, where a descent ended."""
  here = Place(twin, readings, noise, theta, starts)
  return _concluded(here, here.columns(*moved(here, list(free))), noise, free, spent + 12 + len(free), settled)


def _concluded(
  here: Place, made: tuple[Array, Array], noise: Noise, free: ParameterSet, spent: int, settled: bool
) -> Minimum:
  white, _ = here.whiten(noise, here.residual, here.gap, here.starts, *made)
  values = here.theta[indices(here.twin, free)]
  rows = white.rows(slice(1, None)).reshape(-1, len(free))
  precision = rows.T @ rows + np.diag(free.std**-2)
  cost = white.cost + noise.distrust(here.readings) + 0.5 * float(np.sum(prior_of(free, values) ** 2))
  return Minimum(free, here.theta, here.starts, noise, cost, here, white, precision, spent, settled)


def heeding(place: Place, noise: Noise) -> Noise:
  """The noise with trusts by what the smoothed states leave over."""
  shift, others = place.smoothed(noise, place.residual, place.gap, place.starts)
  return noise.heeding(place.readings, place.left_over(shift, others))


def _posterior(place: Place, noise: Noise, free: ParameterSet, values: Array, starts: Array) -> float:
  white, _ = place.whiten(noise, place.residual, place.gap, starts)
  return white.cost + noise.distrust(place.readings) + 0.5 * float(np.sum(prior_of(free, values) ** 2))


def _descend(
  place: Place, noise: Noise, free: ParameterSet, theta: Array, starts: Array, made: tuple[Array, Array]
) -> tuple[Array, Array, float, int]:
  """Chord steps with one linearisation: parameters, starts, nats gained and simulations spent."""
  at, residual, gap = indices(place.twin, free), place.residual, place.gap
  white, _ = place.whiten(noise, residual, gap, starts, *made)
  columns = white.rows(slice(1, None)).reshape(-1, len(free))
  curvature = columns.T @ columns + np.diag(free.std**-2)
  cost = begun = white.cost + 0.5 * float(np.sum(prior_of(free, theta[at]) ** 2))
  spent = 0
  for chord in range(_CHORD):
    error = white.rows(0).ravel()
    squares = np.bincount(place.readings.recording, (white.rows(0) ** 2).sum(axis=1)).astype(np.float64)
    slope = columns.T @ error - prior_of(free, theta[at]) / free.std
    step = bounded(curvature, slope, theta[at], free.lower, free.upper)
    promised, share, better = float(slope @ step - 0.5 * step @ curvature @ step), 1.0, False
    for _ in range(_HALVINGS if chord == 0 else 1):
      tried = theta.copy()
      tried[at] = np.clip(theta[at] + share * step, free.lower, free.upper)
      change = made[0] @ (share * step), made[1] @ (share * step)
      shift, _ = _smoothed(place, noise, residual, gap, starts, change)
      begun_at, r, g, after = _best_starts(place, noise, tried, starts, np.clip(shift, -_LARGEST, _LARGEST), squares)
      spent += 2
      reached = after.cost + 0.5 * float(np.sum(prior_of(free, tried[at]) ** 2))
      better = reached < cost
      if better:
        break
      share *= 0.35
    if not better:
      break
    down, cost, theta, starts, residual, gap, white = cost - reached, reached, tried, begun_at, r, g, after
    if down < SETTLED or promised < SETTLED:
      break
  return theta, starts, begun - cost, spent


def _best_starts(
  place: Place, noise: Noise, theta: Array, starts: Array, shift: Array, before: Array
) -> tuple[Array, Array, Array, Whitened]:
  """Starts moved by as much of a shift as suits each recording: starts, residual, gaps, whitened.

  Args:
    before: squares of every recording so far; where none gets worse, the whole shift is taken without trying others.
  """
  promising = lambda squares: bool(np.all(squares <= before))
  whole = Whitened(before, before, np.inf)
  recording, unit, tried = place.readings.recording, _unit(place), []
  for share in _SHARES:
    if share == _SHARES[1] and promising(tried[0][0]):
      return tried[0][1], tried[0][2], tried[0][3], whole
    moved_to = starts + share * shift * unit
    predicted, ended = place.simulate(theta[None], moved_to)
    r, g = _finite(*place.misfit(predicted[0], ended[0], moved_to))
    white, _ = place.whiten(noise, r, g, moved_to)
    whole = white if share == 1.0 else whole
    tried.append((np.bincount(recording, (white.rows(0) ** 2).sum(axis=1)), moved_to, r, g))
  best = np.argmin([t[0] for t in tried], axis=0)[recording]
  chosen, r, g = (np.choose(best[:, None], [t[k] for t in tried]) for k in (1, 2, 3))
  # a gap belongs to both its windows, which lie in one recording
  return chosen, r, g, place.whiten(noise, r, g, chosen)[0]


def _finite(residual: Array, gap: Array) -> tuple[Array, Array]:
  return np.clip(np.nan_to_num(residual, nan=1e3), -1e3, 1e3), np.nan_to_num(gap, nan=1e3)


def _unit(place: Place) -> Array:
  """1, but for the motor's speed, whose unit is not the car's."""
  return np.sqrt(place.prior) / np.array([0.3, 0.3, 0.3, 0.5, 0.1, 0.1, 0.1])


def _smoothed(
  place: Place, noise: Noise, residual: Array, gap: Array, starts: Array, change: tuple[Array, Array]
) -> tuple[Array, Array]:
  """By how much starts move when the parameters' change, compressed (J, rows), is taken off, in units of `_unit`."""
  left = residual - np.matmul(change[0][:, None], place.basis)[:, 0]
  shift, others = place.smoothed(noise, left, gap + change[1], starts)
  return shift / _unit(place), others


def bounded(curvature: Array, slope: Array, values: Array, lower: Array, upper: Array) -> Array:
  """The step to a quadratic's minimum within bounds: what would leave them stops there, the others go on."""
  free, step = np.ones(len(values), dtype=bool), np.zeros(len(values))
  for _ in range(6):
    rest = slope - curvature[:, ~free] @ step[~free]
    step[free] = np.linalg.solve(curvature[np.ix_(free, free)], rest[free])
    beyond = free & ((values + step < lower) | (values + step > upper))
    if not beyond.any():
      break
    step[beyond] = np.clip(values + step, lower, upper)[beyond] - values[beyond]
    free &= ~beyond
  return step
