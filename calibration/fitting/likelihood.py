"""The twin with its whole catalogue, set against one set of recordings.

Residuals are predicted minus measured, divided by each channel's standard deviation and by the
square root of its correlation length in samples, so that half their sum of squares counts
independent samples ("nats"), not rows of a log.
"""

import contextlib
import dataclasses
import functools
import logging
from collections.abc import Iterator, Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from calibration.copies import copies, filled
from calibration.fitting.observations import CHANNELS, Observations
from calibration.fitting.residual_channels import RESIDUALS
from calibration.fitting.surrogate import Stretch, Surrogate
from qcar_twin.parameters import ParameterSet
from qcar_twin.plant import Driving, Prediction
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

_APART = 1e150  # in any unit: more is no motion, and its square no number
_WORST = 1e3  # standard deviations that a residual counts at most
_SPIKE = 6.0  # residuals beyond this many standard deviations lose weight
_MEMORY = 0.1  # s within which samples of one channel count as one witness
_COLUMNS = 48  # simulations of the whole data set held in memory at once
_WORTH_A_COPY = 400_000  # residuals; fewer are done sooner than a copy of the process is made
_KEPT = 3  # predictions
NOTICED = 10.0  # nats: no decision hangs on a smaller error; hardly a claim rests on twice as many
# of a predicted reduction: below, a model is not trusted over that step (Nocedal and Wright, 2nd ed., algorithm 4.1)
_TRUSTED = 0.25
_LEGS = 4  # parts after each of which a trial that costs too much is given up


@dataclasses.dataclass(frozen=True)
class Weighting:
  """How residuals become nats.

  Attributes:
    std: standard deviation per channel of CHANNELS; NaN where a channel is absent.
    correlation: correlation length per channel, samples.
    spike: weight per value against spikes, (M,).
  """

  std: Array
  correlation: Array
  spike: Array

  def scale(self, channel: NDArray[np.int64]) -> Array:
    """Factor on predicted minus measured, (M,)."""
    return np.sqrt(self.spike / self.correlation[channel]) / self.std[channel]


class Problem:
  """Whitened residuals of the twin for any parameter vectors."""

  def __init__(
    self, twin: Twin, observations: Observations, weighting: Weighting, n_train: int, base: Sequence[str] | None = None
  ):
    """`n_train`: so many values, from the front, are fitted; the rest only judge (role "validate").

    `base`: names of the parameters every model fits; the base twin's by default.
    """
    self.twin, self.observations, self.weighting, self.n_train = twin, observations, weighting, n_train
    self.base = tuple(base or twin.base.names)
    self._scale = weighting.scale(observations.channel)
    self._parts = observations.split(n_train)
    self._predicted: dict[bytes, Prediction] = {}

  @property
  def parameters(self) -> ParameterSet:
    return self.twin.parameters

  @functools.cached_property
  def driving(self) -> Driving:
    """When and where all recordings were driven that are fitted or judge."""
    return self.observations.stretches.segments.driving

  def mechanism(self, name: str) -> Mechanism:
    return next(m for m in self.twin.mechanisms if m.name == name)

  def reweighted(self, weighting: Weighting) -> "Problem":
    return Problem(self.twin, self.observations, weighting, self.n_train, self.base)

  def fitting(self, n_train: int) -> "Problem":
    """The same with so many values, from the front, that are fitted."""
    return Problem(self.twin, self.observations, self.weighting, n_train, self.base)

  def at(self, theta: Array) -> "Problem":
    """The same with what is searched with put right by MuJoCo at full parameters, (P,); see surrogate.py."""
    if not isinstance(self.twin, Surrogate):
      return self
    return Problem(self.twin.at(theta), self.observations, self.weighting, self.n_train, self.base)

  def guarding(self, stretches: Sequence[Stretch]) -> "Problem":
    """The same with these stretches simulated by MuJoCo whatever the parameters."""
    if not isinstance(self.twin, Surrogate):
      return self
    return Problem(self.twin.guarding(stretches), self.observations, self.weighting, self.n_train, self.base)

  @functools.cached_property
  def exact(self) -> "Problem":
    """The same on MuJoCo."""
    if not isinstance(self.twin, Surrogate):
      return self
    return Problem(self.twin.exact, self.observations, self.weighting, self.n_train, self.base)

  def raw(self, theta: Array) -> Array:
    """Predicted minus measured in the channels' units, (n, M)."""
    return self._driven(theta, self.observations)

  def predict(self, theta: Array) -> Prediction:
    """Signals of one or more parameter vectors; those of the last few calls are kept."""
    key = np.ascontiguousarray(theta).tobytes()
    if key not in self._predicted:
      while len(self._predicted) >= _KEPT:
        self._predicted.pop(next(iter(self._predicted)))
      self._predicted[key] = self._predict(theta, self.observations)
    return self._predicted[key]

  def residual(self, theta: Array) -> Array:
    """Whitened residuals, (n, M); one that is not finite counts as _WORST."""
    return self._driven(theta, self.observations, self._scale)

  def fitted_residual(self, theta: Array) -> Array:
    """Those of the values that are fitted, (n, n_train): steps and slopes need no others, and the others take time."""
    return self._driven(theta, self._parts[0], self._scale[: self.n_train])

  def fitted_cost(self, theta: Array, limit: Array) -> Array:
    """Half their sum of squares, nats, (n,); inf where it exceeds `limit`, (n,).

    A vector whose first recordings cost more than that already is not simulated on the others.
    """
    cost = np.zeros(len(theta))
    for rows, part in self._legs:
      going = np.flatnonzero(cost <= limit)
      if len(going):
        cost[going] += 0.5 * np.sum(np.square(self._driven(theta[going], part, self._scale[rows])), axis=1)
    return np.where(cost <= limit, cost, np.inf)

  @functools.cached_property
  def _legs(self) -> list[tuple[slice, Observations]]:
    """The recordings that are fitted in a few parts of about equal length, each with its rows of the residual."""
    rest, begin, legs = self._parts[0], 0, []
    between = np.flatnonzero(np.diff(rest.recording)) + 1
    for k in range(1, _LEGS):
      end = int(between[np.argmin(np.abs(between - k * self.n_train / _LEGS))]) if len(between) else begin
      if end > begin:
        leg, rest = rest.split(end - begin)
        legs.append((slice(begin, end), leg))
        begin = end
    return [*legs, (slice(begin, self.n_train), rest)]

  def judging_residual(self, theta: Array) -> Array:
    """Those of the values that only judge, (n, M - n_train)."""
    return self._driven(theta, self._parts[1], self._scale[self.n_train :])

  def _driven(self, theta: Array, observations: Observations, scale: Array | None = None) -> Array:
    """Predicted minus measured, (n, M); with a factor, (M,), times that, and bounded."""
    theta = np.atleast_2d(theta)
    workers = self._workers(len(theta), observations)
    twin = self.twin if workers == 1 else self._apart

    def fill(out: Array, first: int, last: int) -> None:
      at_once = max(1, _COLUMNS // workers)
      for i in range(first, last, at_once):
        these = slice(i, min(i + at_once, last))
        prediction = self._predict(theta[these], observations, twin)
        with np.errstate(all="ignore"):  # of a trial that flies apart
          np.subtract(observations.predict(prediction), observations.measured, out=out[these])
          if scale is not None:
            _bound(np.multiply(out[these], scale, out=out[these]))
        log.info("%d of %d variants driven", min(workers * (these.stop - first), len(theta)), len(theta))

    return filled(fill, len(theta), len(observations), workers) if len(observations) else np.empty((len(theta), 0))

  def _workers(self, variants: int, observations: Observations) -> int:
    """Processes that share the variants: more than one only where there is enough to drive."""
    if self.twin.engine == "mujoco" or variants * len(observations) < _WORTH_A_COPY:
      return 1
    workers = min(self.twin.threads or copies(), copies())
    if workers > 1 and isinstance(self.twin, Surrogate):
      self.twin.prepare(observations.stretches.segments)
    return workers

  @functools.cached_property
  def _apart(self) -> Twin:
    return self.twin.apart()

  def _predict(self, theta: Array, observations: Observations, twin: Twin | None = None) -> Prediction:
    with warnings_logged(), np.errstate(all="ignore"):
      return (twin or self.twin).rollout(theta, observations.stretches.segments)

  def whiten(self, raw: Array) -> Array:
    return raw * self._scale

  def clear(self, noise: Mapping[str, float]) -> Array:
    """Factors on the fitted residuals, (n_train,), at which each channel weighs by its noise and not by a larger error.

    Args:
      noise: standard deviation of residual channels, by name; one that is not named keeps its weight.
    """
    own = self.weighting.std
    factor = [max(own[i] / noise[c], 1.0) if noise.get(c, 0.0) > 0.0 else 1.0 for i, c in enumerate(CHANNELS)]
    return np.nan_to_num(np.array(factor), nan=1.0)[self.observations.channel[: self.n_train]]

  def embed(self, names: Sequence[str], values: Array, around: Array) -> Array:
    """Full vectors, (n, P), with the named parameters set to values (n, len(names))."""
    values = np.atleast_2d(values)
    full = np.tile(around, (len(values), 1))
    full[:, [self.parameters.index(n) for n in names]] = values
    return full


def _bound(residual: Array) -> None:
  """A trial that flies apart counts as bad, not as infinitely bad: squares of the rest would overflow in a solver."""
  np.clip(residual, -_WORST, _WORST, out=residual)
  residual[np.isnan(residual)] = _WORST


@contextlib.contextmanager
def warnings_logged() -> Iterator[None]:
  """MuJoCo's warnings go to the log: a trial that flies apart loses on cost, and is no news for the user.

  MuJoCo itself writes them to the terminal and to a file in the working directory.
  """
  before = mujoco.get_mju_user_warning()
  mujoco.set_mju_user_warning(lambda text: log.debug("MuJoCo: %s", text))
  try:
    yield
  finally:
    mujoco.set_mju_user_warning(before)


def weighting_from(observations: Observations, raw: Array, floor: Mapping[str, float]) -> Weighting:
  """Weights from the residuals of a fitted model, never below the sensors' own noise.

  Where the model flies apart its residuals tell nothing of a channel's scatter, and get no weight.

  Args:
    observations: what was measured.
    raw: predicted minus measured, (M,).
    floor: standard deviation of each sensor channel from the noise model.
  """
  std = np.full(len(CHANNELS), np.nan)
  correlation = np.ones(len(CHANNELS))
  spike = np.ones(len(observations))
  for index in np.unique(observations.channel):
    rows = np.flatnonzero(observations.channel == index)
    size = np.nan_to_num(np.abs(raw[rows]), nan=_APART, posinf=_APART)
    seen = size[size < _APART]
    typical = 1.4826 * np.median(seen) if len(seen) else 0.0
    rms = float(np.sqrt(np.mean(np.minimum(seen, _SPIKE * typical) ** 2))) if len(seen) else 0.0
    std[index] = max(rms, floor.get(CHANNELS[index], 0.0), 1e-9)
    spike[rows] = spike_weights(size, std[index])
    correlation[index] = correlation_length(observations, rows)
  return Weighting(std, correlation, spike)


def flat_weighting(observations: Observations) -> Weighting:
  """Weights that make every channel count by its own spread."""
  return weighting_from(observations, observations.measured, {})


def spike_weights(size: Array, std: Array | float) -> Array:
  """Weight of the square of each residual, whose magnitude is `size`: 1, and less beyond _SPIKE standard deviations."""
  return np.minimum(1.0, _SPIKE * std / np.maximum(size, 1e-12))


def correlation_length(observations: Observations, rows: NDArray[np.int64]) -> float:
  """Samples that count as one witness: those within a tenth of a second; for displacements, within their horizon.

  It is a convention, not an estimate: taken from residuals, a badly fitted channel would look strongly
  correlated, lose its weight and so stay badly fitted.
  """
  time = observations.time[rows]
  steps = np.diff(time)[np.diff(observations.recording[rows]) == 0]
  step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0
  direct = RESIDUALS[CHANNELS[observations.channel[rows[0]]]].is_direct
  return max(1.0, (_MEMORY if direct else observations.horizon) / step)


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
