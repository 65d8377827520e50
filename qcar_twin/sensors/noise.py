"""Errors of a sensor channel: how they are made, and how they are measured at standstill."""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls

from qcar_twin.recordings.channels import channels_of
from qcar_twin.recordings.recording import Recording, RecordingError
from qcar_twin.sensors.streams import CarStreams, own

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ChannelNoise:
  """Errors added to one channel, in its unit.

  Attributes:
    white: standard deviation of independent errors per sample.
    coloured: standard deviation of a first-order Gauss-Markov error.
    correlation: time constant of that error, s.
    bias: standard deviation of the constant error drawn at the start of a run.
    walk: random walk of the bias, unit per sqrt(s).
    spike_chance: probability per sample of a spike.
    spike_size: largest spike; sign and size are uniform, at least half of it.
  """

  white: float = 0.0
  coloured: float = 0.0
  correlation: float = 1.0
  bias: float = 0.0
  walk: float = 0.0
  spike_chance: float = 0.0
  spike_size: float = 0.0

  def __post_init__(self) -> None:
    if min(dataclasses.astuple(self)) < 0.0 or self.correlation <= 0.0 or self.spike_chance > 1.0:
      raise ValueError(f"noise sizes cannot be negative nor a probability above 1: {self}")


class ErrorStream:
  """The errors of c channels of one sensor in N runs, sample by sample.

  Args:
    noises: one per channel.
    count: N.
    interval: between samples, s.
    rng: the sensor's own stream of random numbers.
  """

  def __init__(
    self, noises: tuple[ChannelNoise, ...], count: int, interval: float, rng: np.random.Generator | CarStreams
  ):
    self._rng, self._count, self._interval = rng, count, interval
    self._noise = {f.name: np.array([getattr(n, f.name) for n in noises]) for f in dataclasses.fields(ChannelNoise)}
    self._memory = np.exp(-interval / self._noise["correlation"])  # (c,)
    self.bias = np.zeros((count, len(noises)))
    self._coloured = np.zeros_like(self.bias)
    self.restart(np.ones(count, dtype=bool))

  def restart(self, which: NDArray[np.bool_]) -> None:
    """New biases and a stationary coloured error for some runs; where runs share a stream all draw, to stay in step."""
    draw = own(self._rng, which).standard_normal((2, *self.bias.shape))
    self.bias = np.where(which[:, None], self._noise["bias"] * draw[0], self.bias)
    self._coloured = np.where(which[:, None], draw[1], self._coloured)

  def sample(self, scale: ArrayLike = 1.0) -> Array:
    """The next errors, (N, c). `scale` multiplies the white and the coloured part, (N,) or (N, c)."""
    noise, shape = self._noise, self.bias.shape
    scale = np.asarray(scale, dtype=np.float64)
    scale = scale[:, None] if scale.ndim == 1 else scale
    draw = self._rng.standard_normal((3, *shape))
    self.bias = self.bias + noise["walk"] * math.sqrt(self._interval) * draw[0]
    self._coloured = self._memory * self._coloured + np.sqrt(1.0 - self._memory**2) * draw[1]
    errors = self.bias + scale * (noise["coloured"] * self._coloured + noise["white"] * draw[2])
    if noise["spike_chance"].any():
      lots = self._rng.random((2, *shape))
      sign = np.where(lots[1] < 0.5, -1.0, 1.0)
      size = sign * noise["spike_size"] * (0.5 + 0.5 * np.abs(2.0 * lots[1] - 1.0))
      errors = errors + np.where(lots[0] < noise["spike_chance"], size, 0.0)
    return errors


# -- measured at standstill ----------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Standstill:
  """What a channel shows while the car stands still, in its unit.

  Attributes:
    offset: its mean.
    white: standard deviation of the part independent from sample to sample.
    walk: of the slow drift, unit per sqrt(s).
    coloured, correlation: standard deviation and time constant (s) of the correlated part; 0 and nan without one.
    interval: between samples, s.  samples: how many.
  """

  offset: float
  white: float
  walk: float
  coloured: float
  correlation: float
  interval: float
  samples: int

  @property
  def std(self) -> float:
    """Of white and correlated part together."""
    return math.hypot(self.white, self.coloured)

  def __str__(self) -> str:
    colour = f", coloured {self.coloured:.3g} over {self.correlation:.2g} s" if self.coloured else ""
    return f"offset {self.offset:.4g}, white {self.white:.4g}, walk {self.walk:.3g} per sqrt(s){colour}"


def standstill_noise(recording: Recording) -> Mapping[str, Standstill]:
  """Noise of every measured channel of a recording in which nothing moves.

  Raises:
    RecordingError: the car moves, or there are fewer than 100 samples of every channel.
  """
  for name in ("speed", "motor_speed", "yaw_rate"):
    if name in recording.streams:
      value = recording[name].value
      drift = abs(float(np.median(value[: len(value) // 4]) - np.median(value[-len(value) // 4 :])))
      if np.ptp(value) > 20.0 * max(_white(value), 1e-6) or drift > 5.0 * max(_white(value), 1e-3):
        raise RecordingError(
          f"recording '{recording.name}': {name} changes; noise is measured while the car stands still"
        )
  names = [n for n in channels_of("sensor") if n in recording and len(recording[n]) >= 100]
  if not names:
    raise RecordingError(f"recording '{recording.name}' has no channel with 100 samples; record a minute of standstill")
  return {name: channel_noise(recording[name].time, recording[name].value) for name in names}


def channel_noise(time: Array, value: Array) -> Standstill:
  """White part, drift and correlated part of samples (k,) at times (k,), s.

  The drift follows from the Allan variance, white^2 h / tau + walk^2 tau / 3 (IEEE Std 952); the correlated
  part from the decay of the autocovariance from lag 1 on, which white noise does not enter.
  """
  interval = float(np.median(np.diff(time)))
  clusters = np.unique(np.geomspace(1, max(len(value) // 8, 2), 20).astype(int))
  allan = np.array([_allan_variance(value, size) for size in clusters])
  weight = np.sqrt(len(value) / clusters) / np.maximum(allan, 1e-30)  # relative error grows with cluster size
  design = np.stack([1.0 / clusters, clusters * interval / 3.0], axis=-1)
  (white, walk), _ = nnls(design * weight[:, None], allan * weight)
  coloured, correlation = _correlated(value, interval)
  if coloured > 0.2 * np.std(value):  # a correlated error also bends the Allan variance: it is separated first
    white, walk = max(float(np.var(value)) - coloured**2, 0.0), 0.0
  else:
    coloured, correlation = 0.0, math.nan
  offset = float(np.mean(value))
  return Standstill(offset, math.sqrt(white), math.sqrt(walk), coloured, correlation, interval, len(value))


def _white(value: Array) -> float:
  return float(np.std(np.diff(value)) / math.sqrt(2.0)) if len(value) > 2 else 0.0


def _allan_variance(value: Array, size: int) -> float:
  """Overlapping Allan variance for clusters of `size` samples."""
  total = np.concatenate([[0.0], np.cumsum(value)])
  means = (total[size:] - total[:-size]) / size
  return 0.5 * float(np.mean((means[size:] - means[:-size]) ** 2)) if len(means) > size else float(np.var(value))


def _correlated(value: Array, interval: float) -> tuple[float, float]:
  """Standard deviation and time constant, s, of an exponential autocovariance fitted over lags 1 to 10."""
  centred = value - np.mean(value)
  lags = np.arange(1, min(11, len(value) // 4))
  covariance = np.array([np.mean(centred[:-lag] * centred[lag:]) for lag in lags])
  floor = 3.0 * np.var(value) / math.sqrt(len(value))
  good = np.cumprod(covariance > floor).astype(bool)
  if good.sum() < 2:
    return 0.0, math.nan
  slope, level = np.polyfit(lags[good] * interval, np.log(covariance[good]), 1, w=covariance[good])
  if slope >= -1.0 / (20.0 * lags[-1] * interval):
    return 0.0, math.nan  # hardly decays: a drift, not a correlated error
  return math.exp(0.5 * level), -1.0 / slope
