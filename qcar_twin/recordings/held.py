"""Held commands on a grid of control periods that rows of a log do not keep to.

A command that is taken where a period begins acts up to a period after it was logged, half of one on average, and with
rows that jitter now in this period and now in the next. Its mean over each period moves what is linear as the command
itself does, and a grid that begins where commands change has next to nothing to average.
"""

from collections.abc import Iterable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ON_GRID = 1e-6  # of a period, within which a sample counts as on the grid
_CANDIDATES = np.arange(0.0, 1.0, 0.01)  # of a period


class Held(Protocol):
  """A command's samples, as a recording's `Stream` has them."""

  @property
  def time(self) -> np.ndarray: ...
  @property
  def value(self) -> np.ndarray: ...
  def at(self, time: np.ndarray, tolerance: float = ...) -> np.ndarray: ...


def means(held: Held, time: Array, period: float) -> Array:
  """Means of a held command over the period after each time of a grid, (T,), in its unit."""
  out = held.at(time, _ON_GRID * period)
  change, place = np.diff(held.value), (held.time[1:] - time[0]) / period
  row = np.floor(place + _ON_GRID).astype(np.intp)
  inside = (change != 0.0) & (row >= 0) & (row < len(time)) & (place - row > _ON_GRID)
  np.add.at(out, row[inside], change[inside] * (1.0 - (place - row)[inside]))
  return out


def phase(commands: Iterable[Held], start: float, period: float) -> float:
  """Where in a period after `start` a grid begins whose periods average least of what commands do, s, below `period`.

  Of a change D a share g of a period after one begins, the mean spreads its moment by D^2 g (1 - g); changes count in
  ranges of their command. 0 where none changes, or any phase is as good.
  """
  lost = np.zeros(len(_CANDIDATES))
  for held in commands:
    change = np.diff(held.value)
    if not change.any():
      continue
    gone = (held.time[1:] - start) / period - _CANDIDATES[:, None]
    gone -= np.floor(gone)
    lost += (gone * (1.0 - gone)) @ (change / np.ptp(held.value)) ** 2
  best = int(np.argmin(lost))
  return 0.0 if lost[0] <= lost[best] + _ON_GRID else float(_CANDIDATES[best]) * period
