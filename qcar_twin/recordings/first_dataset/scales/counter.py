"""Counts that add up, an encoder's or a magnet's on a wheel: a speed is their change, in no unit yet."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.first_dataset.columns import Columns
from qcar_twin.recordings.first_dataset.names import readings

Array = NDArray[np.float64]
SLOPE = "slope of "
_MANY = 100  # steps, of a car that drove some metres by any encoder; a counter of laps or of gears has fewer
_SPAN = 25  # rows, over which a speed is taken: a quarter of a second of most logs
_STOOD, _VARIES = 0.02, 2.0  # share of the rows in which a car stands at least; its usual speed to its slowest ones
_ROWS = 4 * _SPAN  # fewest of a log that shows it


def adds_up(columns: Columns, name: str) -> bool:
  """Whether a column without a known name holds whole numbers that only grow, as fast as a car drives: for a while not
  at all, and at other times at unlike rates. A clock, and what numbers the rows, goes on evenly."""
  if readings(name) or columns.constant(name):
    return False
  steps = []
  for table in columns.holding(name):
    values = table.number(name, name)
    if not np.isfinite(values).all() or (values != np.round(values)).any() or (np.diff(values) < 0.0).any():
      return False
    if values.size < _ROWS or np.ptp(values) < _MANY:
      continue
    steps.append(values[_SPAN:] - values[:-_SPAN])
  if not steps:
    return False
  grown = np.concatenate(steps)
  moving = grown[grown > 0.0]
  slow, fast = np.percentile(moving, [10.0, 90.0])
  return bool(np.mean(grown == 0.0) > _STOOD and fast > _VARIES * slow)


def with_slope(columns: Columns, name: str) -> Columns:
  """The same logs with one column more, `slope of NAME`: how much what adds up changes from row to row, on average
  over a quarter of a second or so."""
  tables = []
  for table in columns.tables:
    if name not in table:
      continue
    values = np.pad(table.number(name, name), (_SPAN // 2, _SPAN - _SPAN // 2), mode="edge")
    slope = (values[_SPAN:] - values[:-_SPAN]) / _SPAN
    tables.append(dataclasses.replace(table, columns={**table.columns, f"{SLOPE}{name}": slope}))
  return Columns(tables, columns.gear_ratio)
