"""The least error a simulation can have on a recording: the sensors' own noise, at standstill and while driving."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.noise import ChannelNoise
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.recording import Recording, Stream

Array = NDArray[np.float64]

_ORDER = 4  # of the difference that takes the motion away; white noise of deviation s leaves s sqrt(binom(8, 4))
_GAIN = float(np.sqrt(70.0))
_UNEVEN = 0.25  # of the usual interval, by which one may differ that counts as equal
_ROLLS = 0.05  # of a recording's largest speed, below which the car stands or nearly so
_NORMAL = 1.4826  # standard deviation of a normal variable over its median size


def sensor_floor(noise_models: Mapping[str, ChannelNoise]) -> dict[str, float]:
  """Standard deviation of each residual channel that the sensors make at standstill."""
  return residual_floor({name: noise.std for name, noise in noise_models.items()})


def driving_noise(recordings: Sequence[Recording]) -> dict[str, float]:
  """White noise of each sensor channel while the car rolls, from what no smooth motion makes.

  Fourth differences of equally spaced samples take away any motion that a cubic follows over five of them and keep
  white noise (Gasser, Sroka & Jennen-Steinmetz, Residual variance and residual pattern in nonlinear regression,
  Biometrika 73, 1986, with a higher order); the median of their size is deaf to jolts and spikes.
  """
  sizes: dict[str, list[Array]] = {}
  for recording in recordings:
    for name in recording.channels:
      if not CHANNELS[name].is_measured:
        continue
      time, size = rough_differences(recording[name])
      sizes.setdefault(name, []).append(size[_moving(recording, time)])
  joined = {name: np.concatenate(parts) for name, parts in sizes.items()}
  return {name: _NORMAL * float(np.median(v)) for name, v in joined.items() if len(v)}


def rough_differences(stream: Stream) -> tuple[Array, Array]:
  """Time [s] and size of each fourth difference of equally spaced samples, as standard deviations of white noise."""
  steps = np.diff(stream.time)
  if len(steps) < _ORDER:
    return np.zeros(0), np.zeros(0)
  usual = np.median(steps)
  usually = np.asarray(np.abs(steps - usual) < _UNEVEN * usual)
  even = np.all(np.lib.stride_tricks.sliding_window_view(usually, _ORDER), axis=1)
  return stream.time[: len(even)][even], (np.abs(np.diff(stream.value, _ORDER)) / _GAIN)[even]


def _moving(recording: Recording, time: Array) -> NDArray[np.bool_]:
  """Whether the car rolls at each time; everywhere where no channel tells its speed."""
  name = next((n for n in ("motor_speed", "speed") if n in recording), None)
  if name is None:
    return np.ones(len(time), dtype=bool)
  stream = recording[name]
  size = np.abs(stream.value)
  return np.interp(time, stream.time, size) > _ROLLS * float(size.max(initial=0.0))


def residual_floor(std: Mapping[str, float]) -> dict[str, float]:
  """Deviations of recorded channels as those of residual channels: a displacement carries the noise of two poses."""
  made = {c.name: c.noise(*(std[n] for n in c.needs)) for c in RESIDUALS.values() if std.keys() >= set(c.needs)}
  return dict(std) | made
