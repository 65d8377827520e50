"""A folder of tables, one per topic, as bags are exported to: every topic's numbers as columns `file.column`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from qcar_twin.recordings.clock_units import unit_of_clock
from qcar_twin.recordings.formats.composed import composed, of_cells, parts_of_others
from qcar_twin.recordings.formats.table import Clocked, NoSamples, Table, merge
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import unit_of, words_of
from qcar_twin.untrusted import inside

_TABLES = (".csv", ".tsv", ".parquet")  # what topics are exported to; text files beside them are notes
_BAG, _STORED = "metadata.yaml", {".db3", ".mcap"}  # what describes a ROS 2 bag, and among the suffixes of its data
_CLOCKS = {
  "time", "times", "stamp", "stamps", "timestamp", "timestamps", "clock", "t", "sec", "secs", "seconds",
  "millis", "micros",
}  # fmt: skip
_NANOSECONDS = {"nanosec", "nanosecs", "nsec", "nsecs"}  # of a stamp, whose seconds are a column of their own
_HEADER = {"header", "stamp"}  # of a message, which says when it was measured; other clocks say when it was received
_ALIKE = 30.0  # times another clock's readings, up to which two are of one unit: usual ones are a thousand apart
_LATE = 0.01  # share of rows that a logger of several threads writes out of order


def is_bag(folder: Path) -> bool:
  """Whether a folder is a ROS 2 bag: its description says so, unless that lies beside tables exported from it alone."""
  return (folder / _BAG).is_file() and (_holds_data(folder) or not _tables(folder))


def _holds_data(folder: Path) -> bool:
  return any(_STORED & set(path.suffixes) for path in folder.iterdir())


def tables_in(folder: Path) -> list[Path]:
  """The tables directly in a folder by name; none where it holds a bag's data, or where a link leads elsewhere."""
  return [] if _holds_data(folder) else _tables(folder)


def _tables(folder: Path) -> list[Path]:
  files = [path for path in sorted(folder.iterdir()) if path.is_file() and not path.name.startswith(".")]
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
  parts, topics, spans, notes, said = [], [], {}, [], {}
  for file in files:
    try:
      part = read(inside(path, file.name), f"{label}/{file.name}")
    except NoSamples:  # a topic on which nothing was published
      continue
    clock = stamps_of(part)
    if clock is None:
      notes.append(f"{part.label}: has no column that is a clock by its name; left out of {label}")
      continue
    parts.append((part, file.name if stems.count(file.stem) > 1 else file.stem, *clock))
    notes += part.notes
  times = _in_one_unit([(name, composed(part).columns[name], time) for part, _, name, time in parts])
  for (part, topic, name, _), time in zip(parts, times, strict=True):
    topics.append(_topic(part, name, time, topic, said))
    spans[part.label] = (float(topics[-1].time[0]), float(topics[-1].time[-1]))
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
  for name in clocks_of(table):
    values = table.columns[name]
    if values.dtype == object or not values.size or not np.isfinite(values).all():
      continue
    steps = np.diff(values)
    if values.size > 1 and (np.sum(steps < 0.0) > _LATE * steps.size or not (steps > 0.0).any()):
      continue
    return name, _scale(name, values) * values
  return None


def clocks_of(table: Table) -> list[str]:
  """Columns that are clocks by their names, a message's header's first."""
  none = {*parts_of_others(table.columns), *table.ambiguous}
  named = [name for name in table.columns if set(words_of(name)) & _CLOCKS and name not in none]
  return sorted(named, key=lambda each: not set(words_of(each)) >= _HEADER)


def _topic(table: Table, clock: str, time: np.ndarray, name: str, said: dict[str, np.ndarray]) -> Clocked:
  """A table's numbers in order of their stamps, s, under `name.column`; `said` gets the stamps, by column, at which the
  file itself says NaN, as none of its blank cells does."""
  own = {**table.columns, **of_cells(table)}
  gone = {clock, *(part for part in parts_of_others(table.columns) if set(words_of(part)) & (_CLOCKS | _NANOSECONDS))}
  numbers = {key: v for key, v in own.items() if key not in gone and key not in table.ambiguous and v.dtype != object}
  said |= {f"{name}.{key}": time[rows] for key, rows in table.not_a_number.items() if key in numbers and rows.size}
  order = np.argsort(time, kind="stable")
  return Clocked(time[order], {f"{name}.{key}": values[order] for key, values in numbers.items()})


def _in_one_unit(clocks: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> list[np.ndarray]:
  """Each clock in s. A topic of few samples has steps that fit a smaller unit: where its readings are as large as those
  of the clock of its name with the shortest steps, they are in that one's unit.

  Args:
    clocks: of each topic the name, the readings (k,), and these in s by themselves.
  """
  step = lambda readings: float(np.median(np.diff(readings))) if readings.size > 1 else math.inf
  times = []
  for name, readings, time in clocks:
    _, finest, seconds = min((clock for clock in clocks if clock[0] == name), key=lambda clock: step(clock[1]))
    largest = int(np.abs(readings).argmax()), int(np.abs(finest).argmax())
    sizes = [float(abs(readings[largest[0]])), float(abs(finest[largest[1]]))]
    if min(sizes) > 0.0 and max(sizes) < _ALIKE * min(sizes):
      own, unit = abs(time[largest[0]]) / sizes[0], abs(seconds[largest[1]]) / sizes[1]
      time = time if math.isclose(own, unit, rel_tol=1e-6) else unit * readings
    times.append(time)
  return times


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
