"""Moments worth a look: the seconds of one measured channel in which a difference is largest against sensor noise."""

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.holdout_errors import ChannelFit, Replay
from calibration.fitting.observations import Observations
from calibration.fitting.residual_channels import RESIDUALS

Array = NDArray[np.float64]

LASTS = 2.0  # s of a moment
AROUND = 0.5  # s shown on either side of it
_FEWEST = 5  # values in a moment


@dataclasses.dataclass(frozen=True, eq=False)
class Seconds:
  """Some seconds of one channel, as measured and as two twins predict it, in the channel's unit.

  Attributes:
    recording: its name.
    channel: of RESIDUALS.
    start, end: of the moment, s of the recording.
    size: root mean square of the difference in the moment, in multiples of the sensor noise.
    noise: standard deviation of the sensor.
    time, measured, before, after: with what lies around the moment in the same simulated stretch, (n,).
  """

  recording: str
  channel: str
  start: float
  end: float
  size: float
  noise: float
  time: Array
  measured: Array
  before: Array
  after: Array


def largest(replay: Replay, fits: Mapping[str, ChannelFit], difference: Array) -> Seconds | None:
  """The moment in which a difference is largest against sensor noise; None where no channel has a known noise.

  Channels that a sensor measures directly come first; displacements are looked at where there are no others.

  Args:
    replay: what was measured and what two twins make of it.
    fits: noise by channel.
    difference: per value, (M,), in each channel's unit: between two twins, or between a twin and the measurement.
  """
  observations = replay.observations
  known = [c for c in observations.present if c in fits and fits[c].noise > 0.0]
  direct = [c for c in known if RESIDUALS[c].is_direct]
  best = (-1.0, "", np.zeros(0, dtype=int), 0, 0)
  for channel in direct or known:
    for rows in _stretches(observations, channel):
      size, first, last = _window(observations.time[rows], difference[rows] / fits[channel].noise)
      best = max(best, (size, channel, rows, first, last), key=lambda found: found[0])
  size, channel, rows, first, last = best
  return _seconds(replay, channel, rows, (first, last), size, fits[channel].noise) if len(rows) else None


def _stretches(observations: Observations, channel: str) -> Iterator[NDArray[np.int64]]:
  """Rows of a channel, stretch by stretch, in time; those with few values left out."""
  rows = np.flatnonzero(observations.select(channel))
  stretch = observations.stretch[rows]
  for number in np.unique(stretch):
    own = rows[stretch == number]
    if len(own) >= _FEWEST:
      yield own[np.argsort(observations.time[own], kind="stable")]


def _window(time: Array, difference: Array) -> tuple[float, int, int]:
  """Root mean square of a difference in the `LASTS` seconds where it is largest, with their first and last index."""
  ends = np.searchsorted(time, time + LASTS, side="right")
  total = np.concatenate([[0.0], np.cumsum(difference**2)])
  whole = np.flatnonzero(time + LASTS <= time[-1] + 1e-9)
  starts = whole if len(whole) else np.zeros(1, dtype=np.int64)
  sizes = (total[ends[starts]] - total[starts]) / np.maximum(ends[starts] - starts, _FEWEST)
  best = int(np.argmax(sizes))
  return float(np.sqrt(sizes[best])), int(starts[best]), int(ends[starts[best]]) - 1


def _seconds(
  replay: Replay, channel: str, rows: NDArray[np.int64], span: tuple[int, int], size: float, noise: float
) -> Seconds:
  observations = replay.observations
  time, measured = observations.time[rows], observations.measured[rows]
  start, end = float(time[span[0]]), float(time[span[1]])
  shown = (time >= start - AROUND) & (time <= end + AROUND)
  before, after = (measured + errors[rows] for errors in (replay.before, replay.after))
  return Seconds(
    recording=observations.names[observations.recording[rows[0]]],
    channel=channel,
    start=start,
    end=end,
    size=size,
    noise=noise,
    time=time[shown],
    measured=measured[shown],
    before=before[shown],
    after=after[shown],
  )
