"""Two clocks of one drive that do not run alike: a microcontroller's resonator beside a computer's crystal.

The lag between two files' motions is found in pieces of a drive. A line through the lags, lag + r (t - t_mid) with one
r of all drives, since the two devices are the same, tells how much faster one clock runs. Deviations are the
jackknife's over the pieces (Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.first_dataset.parts.motion import PERIOD, Motion, fit

Array = NDArray[np.float64]
_PIECE = 8.0  # s of a drive, in which a lag is told to a few hundredths
_LEAST = 4  # pieces that a line and its deviation are told by
_ALIKE = 0.6  # correlation of a piece: less motion than a whole drive's
_NEAR = 1.0  # s about the whole drive's lag in which a piece's is sought
_SURE = 4.0  # deviations
_NOTICED = PERIOD  # s over the longest drive, below which clocks run alike: the grid of motions
_MOST = 0.03  # of a second a second: cheap resonators are within 1 %, and what is more is no clock's


class Pair(NamedTuple):
  """Two files of a drive.

  Attributes:
    car, other: what they say of the motion.
    lag: s, to be added to the other's clock as a whole.
    turned: as `fit` takes it.
  """

  car: Motion
  other: Motion
  lag: float
  turned: int


@dataclasses.dataclass(frozen=True)
class Clock:
  """How a file's clock becomes the drive's: rate * time + shift, s."""

  shift: float = 0.0
  rate: float = 1.0


def drifts(pairs: Sequence[Pair]) -> tuple[float, tuple[Clock, ...]]:
  """By how much the clocks of the first files run faster than the others', s a second, and how each becomes the
  drive's, which is the other's, moved; 0 and clocks as they are where that isn't sure.

  A piece whose ends lie apart tells a little less than the whole, so that it is sought twice.
  """
  first = _faster(pairs)
  if first == 0.0:
    return 0.0, tuple(Clock() for _ in pairs)
  total = first + _faster([p._replace(car=_slowed(p.car, first)) for p in pairs], sure=False) * (1.0 + first)
  clocks = []
  for pair in pairs:
    line = _lags(pair._replace(car=_slowed(pair.car, total)))
    left = float(np.median(line[:, 1])) if len(line) else 0.0  # of the lag, once both clocks run alike
    begin = pair.car.start
    clocks.append(Clock(begin - begin / (1.0 + total) - left, 1.0 / (1.0 + total)))
  return total, tuple(clocks)


def _faster(pairs: Sequence[Pair], sure: bool = True) -> float:
  lags = [line for pair in pairs if len(line := _lags(pair)) >= _LEAST]
  if not lags:
    return 0.0
  time, lag = np.concatenate([line - line.mean(axis=0) for line in lags]).T
  longest = max(float(np.ptp(line[:, 0])) for line in lags) + _PIECE
  slope = lambda rows: float(time[rows] @ lag[rows]) / float(time[rows] @ time[rows])
  every = np.arange(time.size)
  without = np.array([slope(every != k) for k in every])
  value = slope(every >= 0)
  std = float(np.sqrt((time.size - 1) * np.mean((without - without.mean()) ** 2)))
  seen = abs(value) > _SURE * std and _NOTICED < abs(value) * longest and abs(value) < _MOST
  return value if seen or not sure else 0.0


def _slowed(motion: Motion, faster_by: float) -> Motion:
  """A motion whose clock ran too fast, from its start on."""
  own = PERIOD * np.arange(motion.size) / (1.0 + faster_by)
  grid = np.arange(0.0, own[-1], PERIOD)
  moved = lambda values: None if values is None else np.interp(grid, own, values)
  end = motion.start + (motion.end - motion.start) / (1.0 + faster_by)
  pushes = tuple(np.interp(grid, own, push) for push in motion.pushes)
  return Motion(motion.start, end, moved(motion.speed), moved(motion.turning), motion.sensed, pushes)


def _lags(pair: Pair) -> Array:
  """Middles of pieces, on the drive's clock, and lags there, s, (k, 2)."""
  car, other = pair.car, pair.other
  shifted = dataclasses.replace(other, start=other.start + pair.lag, end=other.end + pair.lag)
  begin, end = max(car.start, shifted.start), min(car.end, shifted.end)
  rows = []
  for first in np.arange(begin, end - _PIECE, _PIECE):
    piece = _cut(car, first, first + _PIECE)
    own = fit(piece, _cut(shifted, first - _NEAR, first + _PIECE + _NEAR), pair.turned)
    if own.alike > _ALIKE and abs(own.lag) < _NEAR:
      rows.append((first + 0.5 * _PIECE, own.lag))
  return np.array(rows).reshape(-1, 2)


def _cut(motion: Motion, begin: float, end: float) -> Motion:
  """A part of a motion."""
  first = max(round((begin - motion.start) / PERIOD), 0)
  last = min(round((end - motion.start) / PERIOD), motion.size)
  part = lambda values: None if values is None else values[first:last]
  return Motion(motion.start + first * PERIOD, motion.start + last * PERIOD, part(motion.speed), part(motion.turning),
                motion.sensed, tuple(push[first:last] for push in motion.pushes))  # fmt: skip
