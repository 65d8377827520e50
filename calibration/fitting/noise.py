"""The noise model: what each sensor does when the car does nothing.

Noise is taken from standstill, where no model can be wrong; where a log has none, from second
differences, which a smooth motion leaves alone: var(x[k-1] - 2 x[k] + x[k+1]) = 6 var(noise).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.channels import channels_of
from qcar_twin.recordings.recording import Recording, Stream

Array = NDArray[np.float64]

_STILL = {"motor_speed": 2.0, "speed": 0.02}  # rad/s, m/s
_LEAST_STILL = 0.4  # s of standstill that count
_LEAST_SAMPLES = 5  # in one of them


@dataclasses.dataclass(frozen=True)
class ChannelNoise:
  """What is known of one channel's noise.

  Attributes:
    std: standard deviation of one sample, in the channel's unit.
    mean: mean at standstill, NaN if it never stood still; a bias for gyro and accelerometer.
    source: "standstill" or "differences".
    autocorrelation: of neighbouring samples at standstill, NaN if unknown.
    quantum: smallest step between different values.
    rate: samples per second; 0 of single samples.
    latest: longest interval between samples, s: a bound on how old a value can be.
  """

  std: float
  mean: float
  source: str
  autocorrelation: float
  quantum: float
  rate: float
  latest: float


def noise_models(recordings: Sequence[Recording]) -> dict[str, ChannelNoise]:
  """The noise of every measured channel that occurs."""
  spans = [(r, _standstills(r)) for r in recordings]
  names = [n for n in channels_of("sensor") if any(n in r for r in recordings)]
  return {name: _channel_noise(name, spans) for name in names}


def standstill_seconds(recordings: Sequence[Recording]) -> float:
  """How long the car stood still with nothing commanded, in all."""
  return float(sum(high - low for r in recordings for low, high in _standstills(r)))


def means_at_rest(recordings: Sequence[Recording], channel: str) -> Array:
  """What a channel reads on average in each standstill of five samples or more, (k,)."""
  still = _still_values(channel, [(r, _standstills(r)) for r in recordings])
  return np.array([float(np.mean(v)) for v in still], dtype=np.float64)


def _standstills(recording: Recording) -> list[tuple[float, float]]:
  """Spans in which the drive's command is zero and the wheels don't turn."""
  speed = next((n for n in _STILL if n in recording), None)
  if speed is None or recording.drive_channel not in recording:
    return []
  stream = recording[speed]
  command = recording[recording.drive_channel].at(stream.time, 0.0)
  quiet = (np.abs(stream.value) < _STILL[speed]) & (np.abs(command) < 1e-6)
  edges = np.flatnonzero(np.diff(np.concatenate([[0], quiet.astype(int), [0]])))
  spans = [(float(stream.time[a]), float(stream.time[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
  # the body still settles for a moment after the wheels have stopped
  return [(low + 0.2, high) for low, high in spans if high - low > _LEAST_STILL + 0.2]


def _still_values(name: str, spans: list[tuple[Recording, list[tuple[float, float]]]]) -> list[Array]:
  """A channel's samples in each span of standstill that has enough of them."""
  pieces = [
    s.value[(s.time >= low) & (s.time <= high)]
    for r, pieces in spans
    if name in r.channels
    for s in [r[name]]
    for low, high in pieces
  ]
  return [v for v in pieces if len(v) >= _LEAST_SAMPLES]


def _channel_noise(name: str, spans: list[tuple[Recording, list[tuple[float, float]]]]) -> ChannelNoise:
  streams = [r[name] for r, _ in spans if name in r.channels]
  still = _still_values(name, spans)
  steps = np.abs(np.concatenate([np.diff(s.value) for s in streams]))
  quantum = float(np.min(steps[steps > 1e-12], initial=np.inf))
  gaps = np.concatenate([np.diff(s.time) for s in streams])
  floor = quantum / np.sqrt(12.0) if np.isfinite(quantum) else 0.0
  if still and sum(map(len, still)) >= 20:
    spread = float(np.sqrt(np.mean(np.concatenate([(v - v.mean()) ** 2 for v in still]))))
    mean, source = float(np.mean(np.concatenate(still))), "standstill"
    if spread <= floor * 1e-3:  # a wheel encoder shows nothing at all at standstill
      spread, source = _difference_noise(streams), "differences"
    correlation = float(np.mean([_neighbour_correlation(v) for v in still]))
  else:
    spread, mean, source, correlation = _difference_noise(streams), np.nan, "differences", np.nan
  return ChannelNoise(
    std=max(spread, floor, 1e-9),
    mean=mean,
    source=source,
    autocorrelation=correlation,
    quantum=quantum,
    rate=float(1.0 / np.median(gaps)) if len(gaps) else 0.0,
    latest=float(np.quantile(gaps, 0.99)) if len(gaps) else np.inf,
  )


def _difference_noise(streams: Sequence[Stream]) -> float:
  """Robust noise level from second differences."""
  second = np.concatenate([np.diff(s.value, 2) for s in streams if len(s.value) > 4] or [np.zeros(1)])
  return float(1.4826 * np.median(np.abs(second)) / np.sqrt(6.0))


def _neighbour_correlation(value: Array) -> float:
  centred = value - value.mean()
  power = float(np.sum(centred**2))
  return float(np.sum(centred[1:] * centred[:-1]) / power) if power > 0 else 0.0
