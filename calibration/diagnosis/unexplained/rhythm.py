"""Rhythms in a residual: a line in its spectrum over time or over turns of the wheels, whatever its phase.

Each stretch is transformed by itself. Noise with a smooth spectrum of power B(f) gives P(f) / B(f) an exponential
distribution with mean one, and P / B is also the gain in nats of a sinusoid with free amplitude and phase (Priestley,
Spectral Analysis and Time Series, 6.1): the mean excess over one, over all stretches, is the line's evidence.
"""

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.observations import Observations
from qcar_twin.plant import Prediction

Array = NDArray[np.float64]

_BAND, _STEP = (1.0, 22.0), 0.1  # Hz
_ORDERS = np.arange(0.5, 10.0, 0.04)  # lines per turn of the wheels
_LEAST_TURNS = 4.0  # of the wheels in a stretch that counts
_CAP = 10.0  # nats a stretch can bring
_NEAR, _FAR = 0.06, 0.4  # the background is taken between these relative distances from a line


@dataclasses.dataclass(frozen=True)
class Line:
  """The strongest spectral line of a channel.

  Attributes:
    over: "time" or "wheel turns".
    at: Hz, or lines per turn.
    nats: mean excess per stretch.
    stretches: how many had enough data.
    mean_square: of the sinusoid, over all values of those stretches, in the residual's unit squared.
  """

  over: str
  at: float
  nats: float
  stretches: int
  mean_square: float = 0.0

  @property
  def depends_on(self) -> tuple[str, ...]:
    unit = "Hz" if self.over == "time" else "per turn of the wheels"
    return (f"{self.over}: a rhythm of {self.at:.2g} {unit}",)


def strongest_line(
  residual: Array, observations: Observations, prediction: Prediction, channel: str, turns_per_radian: float
) -> Line:
  """The strongest line of one channel's residual.

  Args:
    residual: of all values, (M,).
    observations, prediction: what was measured, and the model's signals of one vector.
    channel: to look at.
    turns_per_radian: turns of a wheel per radian of the motor.
  """
  rows = np.flatnonzero(observations.select(channel))
  point, grid = observations.grid_points[rows], prediction.signals.shape[2]
  turned = np.cumsum(prediction.channel("motor_speed")[0] * prediction.period * turns_per_radian, axis=1)
  stretches = [np.flatnonzero(point // grid == s) for s in range(prediction.signals.shape[1])]
  lines = [Line("time", 0.0, 0.0, 0)]
  parts = [(observations.time[rows[i]], residual[rows[i]]) for i in stretches if len(i) > 80]
  if parts:
    step = float(np.median(np.concatenate([np.diff(t) for t, _ in parts])))
    lines.append(_line("time", np.arange(_BAND[0], min(_BAND[1], 0.42 / step), _STEP), parts))
  parts = [(turned.reshape(-1)[point[i]], residual[rows[i]]) for i in stretches if len(i) > 80]
  parts = [(x, r) for x, r in parts if abs(x[-1] - x[0]) > _LEAST_TURNS]
  if parts:
    lines.append(_line("wheel turns", _ORDERS, parts))
  return max(lines, key=lambda line: line.nats)


def _line(over: str, frequencies: Array, parts: list[tuple[Array, Array]]) -> Line:
  spectra = [spectrum(frequencies, x, r) for x, r in parts]
  gains = np.mean([np.minimum(excess(power, ground), _CAP) for power, ground in spectra], axis=0)
  # at the ends the background has neighbours on one side only, and a slope looks like a line
  gains[(frequencies < frequencies[0] / (1 - _FAR)) | (frequencies > frequencies[-1] * (1 - _FAR))] = 0.0
  top = int(np.argmax(gains))
  weights = np.array([len(x) for x, _ in parts])
  beyond = np.array([max(power[top] - ground[top], 0.0) for power, ground in spectra])
  mean_square = float(weights @ beyond / weights.sum())
  return Line(over, float(frequencies[top]), float(gains[top]), len(parts), mean_square)


def excess(power: Array, ground: Array) -> Array:
  """P / B - 1 at frequencies, (F,), from `spectrum`."""
  return power / np.maximum(ground, 1e-300) - 1.0


def spectrum(frequencies: Array, position: Array, values: Array) -> tuple[Array, Array]:
  """Power at frequencies (F,), as the mean square of a sinusoid that would have it, and that of its neighbourhood: a
  Hann-tapered transform of values at positions (k,)."""
  share = (position - position[0]) / (position[-1] - position[0])
  taper = np.sin(np.pi * np.clip(share, 0.0, 1.0)) ** 2
  centred = (values - values.mean()) * taper
  phase = 2.0 * np.pi * np.outer(frequencies, position)
  power = 2.0 * ((np.cos(phase) @ centred) ** 2 + (np.sin(phase) @ centred) ** 2) / np.sum(taper) ** 2
  return power, _neighbourhood(tuple(frequencies.tolist())) @ power


@functools.lru_cache(maxsize=64)
def _neighbourhood(frequencies: tuple[float, ...]) -> Array:
  """Weights (F, F) that average over what lies near each frequency."""
  ratio = np.abs(np.log(np.divide.outer(frequencies, frequencies)))
  near = (ratio > _NEAR) & (ratio < _FAR)
  return near / np.maximum(near.sum(axis=1, keepdims=True), 1)
