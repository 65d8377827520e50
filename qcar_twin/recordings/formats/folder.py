"""A folder of tables, one per topic, as bags are exported to: every topic's numbers as columns `file.column`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from qcar_twin.recordings.clock_units import unit_of_clock
from qcar_twin.recordings.formats.composed import composed, of_cells, parts_of_others
from qcar_twin.recordings.formats.table import Clocked, NoSamples, Table, merge
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import unit_of, words_of
from qcar_twin.untrusted import inside

_TABLES = (".csv", ".tsv", ".parquet")  # what topics are exported to; text files beside them are notes
_BAG_PARTS = ("metadata.yaml", ".db3", ".mcap")  # the names, or their ends, that make a folder a bag
_CLOCKS = {
  "time", "times", "stamp", "stamps", "timestamp", "timestamps", "clock", "t", "sec", "secs", "seconds",
  "millis", "micros",
}  # fmt: skip
_NANOSECONDS = {"nanosec", "nanosecs", "nsec", "nsecs"}  # of a stamp, whose seconds are a column of their own
_HEADER = {"header", "stamp"}  # of a message, which says when it was measured; other clocks say when it was received
_LATE = 0.01  # share of rows that a logger of several threads writes out of order


def tables_in(folder: Path) -> list[Path]:
  """The tables directly in a folder by name; none where it is a bag, or where a link leads elsewhere."""
  files = [path for path in sorted(folder.iterdir()) if path.is_file() and not path.name.startswith(".")]
  if any(path.name.endswith(_BAG_PARTS) for path in files):
    return []
  return [path for path in files if path.suffix.lower() in _TABLES]


def read_folder(path: Path, label: str, read: Callable[[Path, str], Table]) -> Table:
  """One row per stamp of any table, NaN where a table has no row then; `time` is the tables' own clock, s.

  `servo_position.data` is the column `data` of `servo_position.csv`. A table without a clock is left out with a note.

  Args:
    read: what reads one of the tables, given its path and its name in errors.

  Raises:
    RecordingError: a table cannot be read, none has a clock, or two clocks have no time in common.
  """
  files = tables_in(path)
  stems = [file.stem for file in files]
  topics, spans, notes, said = [], {}, [], {}
  for file in files:
    try:
      part = read(inside(path, file.name), f"{label}/{file.name}")
    except NoSamples:  # a topic on which nothing was published
      continue
    clock = stamps_of(part)
    if clock is None:
      notes.append(f"{part.label}: has no column that is a clock by its name; left out of {label}")
      continue
    topics.append(_topic(part, *clock, file.name if stems.count(file.stem) > 1 else file.stem, said))
    spans[part.label] = (float(topics[-1].time[0]), float(topics[-1].time[-1]))
    notes += part.notes
  if not topics:
    raise RecordingError(
      f"{label}: no table in this folder has a clock by its name; name the column of stamps `time`, in s, in each"
    )
  _refuse_apart(label, spans)
  table = merge(label, topics)
  nans = {name: np.searchsorted(table.columns["time"], stamps) for name, stamps in said.items()}
  return dataclasses.replace(table, not_a_number=nans, notes=(*notes, *table.notes))


def stamps_of(table: Table) -> tuple[str, np.ndarray] | None:
  """The column that says when each row was, and its values in s; None where no column is a clock by its name. Of
  several clocks that of a message's header counts, else the first."""
  table = composed(table)
  none = {*parts_of_others(table.columns), *table.ambiguous}
  named = [name for name in table.columns if set(words_of(name)) & _CLOCKS and name not in none]
  for name in sorted(named, key=lambda each: not set(words_of(each)) >= _HEADER):
    values = table.columns[name]
    if values.dtype == object or not values.size or not np.isfinite(values).all():
      continue
    steps = np.diff(values)
    if values.size > 1 and (np.sum(steps < 0.0) > _LATE * steps.size or not (steps > 0.0).any()):
      continue
    return name, _scale(name, values) * values
  return None


def _topic(table: Table, clock: str, time: np.ndarray, name: str, said: dict[str, np.ndarray]) -> Clocked:
  """A table's numbers in order of their stamps, s, under `name.column`; `said` gets the stamps, by column, at which the
  file itself says NaN, as none of its blank cells does."""
  own = {**table.columns, **of_cells(table)}
  gone = {clock, *(part for part in parts_of_others(table.columns) if set(words_of(part)) & (_CLOCKS | _NANOSECONDS))}
  numbers = {key: v for key, v in own.items() if key not in gone and key not in table.ambiguous and v.dtype != object}
  said |= {f"{name}.{key}": time[rows] for key, rows in table.not_a_number.items() if key in numbers and rows.size}
  order = np.argsort(time, kind="stable")
  return Clocked(time[order], {f"{name}.{key}": values[order] for key, values in numbers.items()})


def _scale(name: str, values: np.ndarray) -> float:
  """The factor to s of a clock: by the unit in its name, else by its steps and its size."""
  unit = unit_of(name)
  if unit is not None and unit[1] == "s":
    return unit[2]
  steps = np.diff(values)
  step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
  told = unit_of_clock(name, step, float(values.max()))
  return told[0] if told is not None else 1.0


def _refuse_apart(label: str, spans: dict[str, tuple[float, float]]) -> None:
  """Raises RecordingError where two tables have no time in common: they are of two clocks, or of two recordings."""
  last = max(spans, key=lambda file: spans[file][0])
  early = min(spans, key=lambda file: spans[file][1])
  if spans[early][1] < spans[last][0]:
    raise RecordingError(
      f"{early} ends at {spans[early][1]:.9g} s and {last} begins at {spans[last][0]:.9g} s: tables of one recording,"
      f" {label}, have to be on one clock; write both with stamps of the same clock, or move one of them out of the"
      " folder"
    )
