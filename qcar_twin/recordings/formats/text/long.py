"""Long tables, a row for every signal and stamp, as one column per signal."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.formats.folder import clocks_of, stamps_of
from qcar_twin.recordings.formats.table import Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import unit_of, words_of

_VALUE = {"value", "data", "val"}
_UNITS = {"unit", "units"}
_NAMES = {"signal", "field", "channel", "variable", "parameter", "name"}  # of columns that have the signals' names
_HOLDERS = {"message", "msg", "topic", "measurement", "frame", "sensor", "device", "node"}  # that signals are parts of
_LONG, _SIGNALS, _LISTED = 20, 200, 4  # rows and signals of a long table, and how many are named


def spread(table: Table) -> Table:
  """A long table's signals as columns, on their own stamps in s; any other table as it is.

  Foxglove's plots, InfluxDB, decoders of a CAN bus and many a lab's database export so: texts with the names of the
  signals, one column of values, and clocks; a column of units; numbers that stay the same for each signal, as a
  message's identifier does. A signal that occurs in several messages is called after both.

  Raises:
    RecordingError: nothing says when the values were.
  """
  texts = [name for name, values in table.columns.items() if values.dtype == object]
  numbers = [
    name for name in table.columns if name not in texts and words_of(name)[-1:] in [(word,) for word in _VALUE]
  ]
  clocks = clocks_of(table)
  if not texts or len(numbers) != 1 or table.rows < _LONG:
    return table
  rows = {name: _rows(table.columns[name]) for name in texts if name not in table.ambiguous and not _is_unit(name)}
  called = lambda name: len(rows[name]) > 1 and bool(set(words_of(name)) & _NAMES)
  names = max(rows, key=lambda name: (called(name), len(rows[name])), default="")
  if not names or len(rows[names]) < 2:
    return table
  rest = [name for name in table.columns if name not in (*texts, *numbers, *clocks)]
  signals = _signals(table, texts, names, rows[names])
  if not all(_stays(table.columns[name], own) for name in rest for own in signals.values()):
    return table
  for clock in clocks:
    stamps, places = np.unique(table.columns[clock], return_inverse=True)
    if stamps.size > 1 and (told := stamps_of(Table(table.label, {clock: stamps}, {}))) is not None:
      time, values = told[1][places], table.columns[numbers[0]]
      merged = merge(table.label, [_signal(signal, time[own], values[own]) for signal, own in signals.items()])
      return dataclasses.replace(merged, notes=(*table.notes, *merged.notes))
  listed = ", ".join(list(rows[names])[:_LISTED]) + (" …" if len(rows[names]) > _LISTED else "")
  raise RecordingError(
    f"{table.label}: is a long table: '{names}' has the names of {len(rows[names])} signals ({listed}) and "
    f"'{numbers[0]}' their values, and no column is a clock; add one, called time"
  )


def _is_unit(name: str) -> bool:
  return bool(set(words_of(name)) & _UNITS)


def _rows(texts: np.ndarray) -> dict[str, np.ndarray]:
  """The rows of each signal, in the order in which signals come; none where a cell is blank, or there are too many."""
  signals = dict.fromkeys(texts.tolist())
  if None in signals or len(signals) > _SIGNALS:
    return {}
  return {signal: np.flatnonzero(texts == signal) for signal in signals}


def _stays(values: np.ndarray, rows: np.ndarray) -> bool:
  """Whether numbers are the same in these rows, or blank in all of them: they tell of the signal, not of a moment."""
  own = values[rows]
  return bool((own == own[0]).all() or np.isnan(own).all())


def _signals(table: Table, texts: Sequence[str], names: str, rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
  """The rows of each column that is made: of a signal, of each message where several have it, of each of its units."""
  holders = [name for name in texts if name != names and set(words_of(name)) & _HOLDERS]
  units = [name for name in texts if name != names and _is_unit(name)]
  out: dict[str, np.ndarray] = {}
  for signal, own in rows.items():
    parts = {signal: own}
    for holder in holders:
      cells = table.columns[holder]
      if len(set(cells[own].tolist())) > 1:
        parts = {f"{cell}.{name}": r for name, rs in parts.items() for cell, r in _apart(cells, rs)}
    for unit in units:
      parts = {_with_unit(name, cell): r for name, rs in parts.items() for cell, r in _apart(table.columns[unit], rs)}
    out |= parts
  return out


def _apart(cells: np.ndarray, rows: np.ndarray) -> list[tuple[str | None, np.ndarray]]:
  """These rows by what their cells say."""
  return [(cell, rows[cells[rows] == cell]) for cell in dict.fromkeys(cells[rows].tolist())]


def _with_unit(name: str, unit: str | None) -> str:
  return name if not unit or not unit.strip() or unit_of(name) is not None else f"{name} [{unit.strip()}]"


def _signal(name: str, time: np.ndarray, values: np.ndarray) -> Clocked:
  order = np.argsort(time, kind="stable")
  return Clocked(time[order], {name: values[order]})
