"""Which way a log counts, by its wheels: those outside of a turn go faster.

With track b and yaw rate r, counted to the left, the right wheel of an axle goes by b r faster than the left one.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.first_dataset.columns import Columns, Guess
from qcar_twin.recordings.first_dataset.scales.series import correlation
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.formats.axles import pairs_of_wheels

Array = NDArray[np.float64]
_BIN = 0.25  # s, over which noise of the small difference is averaged away
_ALIKE, _LEAST = 0.6, 20  # correlation of that difference with the turning, as of a force with its motion; bins


def side_of(columns: Columns, guesses: Mapping[str, Guess]) -> int:
  """1 where the yaw rate, as it is read, is counted to the left by the wheels of an axle, -1 to the right; 0 where no
  two wheels were logged, they show nothing, or those of two axles contradict each other."""
  if not {"time", "yaw_rate"} <= guesses.keys() or guesses["time"].steps:
    return 0
  alike = [_alike(columns, guesses, *pair) for pair in pairs_of_wheels(columns.names)]
  told = {int(np.sign(one)) for one in alike if abs(one) > _ALIKE}
  return told.pop() if len(told) == 1 else 0


def _alike(columns: Columns, guesses: Mapping[str, Guess], left: str, right: str) -> float:
  """Correlation of the right wheel's speed over the left one's with the yaw rate."""
  gyro = guesses["yaw_rate"]
  tables = [table for table in columns.tables if all(name in table for name in (left, right, gyro.column))]
  parts = [_binned(table, guesses["time"], (left, right, gyro.column)) for table in tables]
  one, other, turned = np.concatenate([np.empty((3, 0)), *parts], axis=1)
  return correlation(other - one, np.sign(gyro.scale) * turned, _LEAST)


def _binned(table: Table, clock: Guess, names: tuple[str, ...]) -> Array:
  """Means of columns in bins of the clock, (columns, bins); NaN where one has no sample."""
  time = clock.scale * table.number(clock.column, "time")
  _, which = np.unique(np.floor((time - time[0]) / _BIN), return_inverse=True)
  means = []
  for values in (table.number(name, name) for name in names):
    there = np.isfinite(values)
    count = np.bincount(which[there], minlength=which.max() + 1)
    means.append(np.bincount(which[there], values[there], count.size) / np.where(count > 0, count, np.nan))
  return np.stack(means)
