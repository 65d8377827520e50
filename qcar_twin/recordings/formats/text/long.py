"""Long tables, a row for every signal and stamp, as one column per signal."""

from __future__ import annotations

import numpy as np

from qcar_twin.recordings.formats.folder import clocks_of, stamps_of
from qcar_twin.recordings.formats.table import Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import words_of

_VALUE = {"value", "data", "val"}
_LONG, _SIGNALS, _LISTED = 20, 200, 4  # rows and signals of a long table, and how many are named


def spread(table: Table) -> Table:
  """A long table's signals as columns, on their own stamps in s; any other table as it is.

  Foxglove's plots, InfluxDB and many a lab's database export so: texts with the names of the signals, one column of
  values, and clocks.

  Raises:
    RecordingError: nothing says when the values were.
  """
  texts = [name for name, values in table.columns.items() if values.dtype == object]
  numbers = [
    name for name in table.columns if name not in texts and words_of(name)[-1:] in [(word,) for word in _VALUE]
  ]
  clocks = clocks_of(table)
  if not texts or len(numbers) != 1 or table.rows < _LONG or len(texts) + 1 + len(clocks) < len(table.columns):
    return table
  rows = {name: _rows(table.columns[name]) for name in texts if name not in table.ambiguous}
  names = max(rows, key=lambda name: len(rows[name]), default="")
  if not names or len(rows[names]) < 2:
    return table
  for clock in clocks:
    stamps, places = np.unique(table.columns[clock], return_inverse=True)
    if stamps.size > 1 and (told := stamps_of(Table(table.label, {clock: stamps}, {}))) is not None:
      time, values = told[1][places], table.columns[numbers[0]]
      return merge(table.label, [_signal(signal, time[own], values[own]) for signal, own in rows[names].items()])
  listed = ", ".join(list(rows[names])[:_LISTED]) + (" …" if len(rows[names]) > _LISTED else "")
  raise RecordingError(
    f"{table.label}: is a long table: '{names}' has the names of {len(rows[names])} signals ({listed}) and "
    f"'{numbers[0]}' their values, and no column is a clock; add one, called time"
  )


def _rows(texts: np.ndarray) -> dict[str, np.ndarray]:
  """The rows of each signal, in the order in which signals come; none where a cell is blank, or there are too many."""
  signals = dict.fromkeys(texts.tolist())
  if None in signals or len(signals) > _SIGNALS:
    return {}
  return {signal: np.flatnonzero(texts == signal) for signal in signals}


def _signal(name: str, time: np.ndarray, values: np.ndarray) -> Clocked:
  order = np.argsort(time, kind="stable")
  return Clocked(time[order], {name: values[order]})
