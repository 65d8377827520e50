"""A log file in memory: named columns of one length, blank cells as NaN."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.recording import RecordingError, nearest


class NoSamples(RecordingError):
  """A log file without a single row: an aborted run, of which nothing can be read."""


NO_ROWS = np.empty(0, dtype=int)
_SHOWN_COLUMNS = 40
_NAMED = 4  # recordings of one file
FEW = 0.05  # a stated prior: of samples that may repeat a stamp, as a message that was sent or a row written twice


@dataclass(frozen=True, eq=False)
class Table:
  """Columns (rows,) as read. Float columns have NaN for a blank cell; text columns are kept to name the bad row.

  `not_a_number`: per column, the rows where the file itself says NaN instead of leaving the cell blank.
  `ambiguous`: column names that occur more than once.
  `blanks`: whether the format can tell a blank cell from a NaN (CSV and Parquet can, NPZ and MAT cannot).
  `headless`: the file names no columns; they are called column_1, column_2 and so on.
  `told`: the columns that the file has, in its order, where it names none and what wrote it is known by them.
  `unsigned`: columns whose negative numbers the file has without their sign, and the numbers' width, bits.
  `notes`: what was left out when the file was read.
  `withheld`: columns that were left out, and why: what is said where one of them is asked for.
  """

  label: str
  columns: Mapping[str, np.ndarray]
  not_a_number: Mapping[str, np.ndarray]
  ambiguous: frozenset[str] = frozenset()
  blanks: bool = True
  headless: bool = False
  unsigned: Mapping[str, int] = dataclasses.field(default_factory=dict)
  notes: tuple[str, ...] = ()
  withheld: Mapping[str, str] = dataclasses.field(default_factory=dict)
  told: tuple[str, ...] = ()

  @property
  def rows(self) -> int:
    return max((column.size for column in self.columns.values()), default=0)

  def __contains__(self, column: object) -> bool:
    return column in self.columns

  def number(self, column: str, channel: str) -> np.ndarray:
    """A numeric column (rows,). Raises RecordingError when it is missing, occurs twice, or holds text."""
    if column in self.withheld:
      raise RecordingError(self.withheld[column])
    if column not in self.columns:
      near = nearest(column, self.columns)
      near = near if near.startswith("; did") else "."
      raise RecordingError(
        f"{self.label}: {channel} is mapped to column '{column}', which does not exist{near} Columns that exist: "
        f"{self.listing()}"
      )
    if column in self.ambiguous:
      raise RecordingError(
        f"{self.label}: column '{column}' occurs more than once, so {channel} is ambiguous; rename one of them"
      )
    values = self.columns[column]
    if values.dtype != object:
      return values
    if not all(_is_number(cell) for cell in values):
      raise RecordingError(self._text_complaint(column, channel, values))
    return np.array([np.nan if cell is None else float(cell) for cell in values])

  def mostly_numbers(self) -> Table:
    """The same with numbers alone in columns of which more than half of the cells that are filled are numbers."""
    columns = dict(self.columns)
    for name, values in self.columns.items():
      if values.dtype != object:
        continue
      known = np.array([cell is not None and _is_number(cell) for cell in values])
      if 2 * known.sum() > sum(cell is not None for cell in values):
        columns[name] = np.array([float(str(c)) if k else np.nan for c, k in zip(values, known, strict=True)])
    return dataclasses.replace(self, columns=columns)

  def named(self, names: Sequence[str]) -> Table:
    """The columns of a file without a header under these names; RecordingError where their number differs."""
    own = self.told or tuple(self.columns)
    if not (self.headless or self.told) or not names:
      return self
    if len(names) != len(own):
      raise RecordingError(
        f"{self.label}: has {len(own)} columns, and columns in dataset.toml names {len(names)}; name each"
      )
    new = dict(zip(own, names, strict=True))
    return dataclasses.replace(
      self,
      columns={name: self.columns[old] for old, name in new.items()},
      not_a_number={name: self.not_a_number[old] for old, name in new.items() if old in self.not_a_number},
      headless=False,
      told=(),
      unsigned={name: self.unsigned[old] for old, name in new.items() if old in self.unsigned},
    )

  def rows_in(self, order: np.ndarray) -> Table:
    """The same rows in another order."""
    place = np.argsort(order)
    return dataclasses.replace(
      self,
      columns={name: values[order] for name, values in self.columns.items()},
      not_a_number={name: np.sort(place[rows]) for name, rows in self.not_a_number.items()},
    )

  def rows_between(self, first: int, last: int) -> Table:
    """The rows from one to before another."""
    return dataclasses.replace(
      self,
      columns={name: values[first:last] for name, values in self.columns.items()},
      not_a_number={name: rows[(rows >= first) & (rows < last)] - first for name, rows in self.not_a_number.items()},
    )

  def listing(self) -> str:
    """The names of the columns, for an error text; the first forty when there are more."""
    names = list(self.columns)
    more = f", and {len(names) - _SHOWN_COLUMNS} more" if len(names) > _SHOWN_COLUMNS else ""
    return ", ".join(names[:_SHOWN_COLUMNS]) + more

  def _text_complaint(self, column: str, channel: str, values: np.ndarray) -> str:
    row, cell = next((row, cell) for row, cell in enumerate(values) if not _is_number(cell))
    about = f"column '{column}'" + (f" for {channel}" if column != channel else "")
    cure = "write numbers with a decimal point, or leave the cell blank where there is no sample"
    if whole := next((name for name in self.columns if name.startswith(f"{column} [")), None):
      cure = f"its numbers are in column '{whole}': map that in [channels]"
    elif channel == "time":
      cure = "time must be a number of seconds in every row, or a date such as 2025-10-05T13:28:47.25"
    return (
      f"{self.label}: {about} has '{' '.join(str(cell)[:40].split())}' in row {row + 1}, which is not a number; {cure}"
    )


def _is_number(cell: object) -> bool:
  if cell is None:
    return True
  try:
    float(str(cell))
  except ValueError:
    return False
  return "_" not in str(cell)  # Python takes 2024_05_01 for a number


class SeveralRecordings(RecordingError):
  """A file that holds several recordings, `tables` by what it calls them; `label` is its own name. `qcar-twin new`
  writes each as a file."""

  def __init__(self, label: str, tables: Mapping[str, Table]):
    self.label, self.tables = label, tables
    names = ", ".join(list(tables)[:_NAMED]) + (" …" if len(tables) > _NAMED else "")
    super().__init__(
      f"{label}: holds {len(tables)} recordings ({names}), and a data set names a file for each; qcar-twin new FOLDER"
      f" {label.rpartition('/')[2]} writes each as a file of its own"
    )


@dataclass(frozen=True, eq=False)
class Clocked:
  """Columns (k,) that share one clock `time` (k,), s: a topic of a bag, a structure with time."""

  time: np.ndarray
  columns: Mapping[str, np.ndarray]


def merge(label: str, groups: Sequence[Clocked]) -> Table:
  """One table from groups with clocks of their own: every time once, in column `time`; NaN where there is no sample.

  Of a few samples of one stamp the first is kept, and a note says so. Raises RecordingError when a group's own clock
  goes backwards, repeats often or has no value.
  """
  groups, notes = list(groups), []
  for k, group in enumerate(groups):
    name = next(iter(group.columns), "time")
    groups[k], again = _each_stamp_once(group)
    if again.size:
      notes.append(
        f"{label}: {again.size} of {group.time.size} samples of '{name}' repeat the stamp before them, first at"
        f" {group.time[again[0]]:.9g} s; left out"
      )
    group = groups[k]
    bad = np.flatnonzero(~(np.diff(group.time) > 0.0))
    if bad.size:
      row = int(bad[0]) + 1
      raise RecordingError(
        f"{label}: time of '{name}' goes backwards or repeats in row {row + 1} ({group.time[row]:.9g} s after "
        f"{group.time[row - 1]:.9g} s); remove that sample, or record again with one clock"
      )
  time = np.unique(np.concatenate([group.time for group in groups])) if groups else np.empty(0)
  columns = {"time": time}
  for group in groups:
    rows = np.searchsorted(time, group.time)
    for name, values in group.columns.items():
      columns[name] = np.full(time.size, np.nan)
      columns[name][rows] = values
  gaps = {
    name: np.searchsorted(time, group.time[np.isnan(values)])
    for group in groups
    for name, values in group.columns.items()
  }
  return Table(label, columns, gaps, notes=tuple(notes))


def merge_kinds(label: str, groups: Sequence[Clocked]) -> Table:
  """The same from a log's messages of several kinds. A kind whose stamps repeat wholesale, as the parameters that an
  autopilot writes all at once, is no series of samples: it is left out with a note, and its columns are withheld.

  Raises:
    RecordingError: no kind is left.
  """
  again = [group.time.size - np.unique(group.time).size for group in groups]
  kept = [group for group, count in zip(groups, again, strict=True) if count <= FEW * group.time.size]
  notes, withheld = [], {}
  for group, count in zip(groups, again, strict=True) if kept else ():
    if count <= FEW * group.time.size:
      continue
    why = f"{count} of its {group.time.size} stamps repeat, so that these are no samples one after the other"
    notes.append(f"{label}: messages of '{next(iter(group.columns), 'time')}' are left out: {why}")
    withheld |= {
      name: f"{label}: '{name}' was left out, {why}; map another column, or log it again with a stamp for each message"
      for name in group.columns
    }
  table = merge(label, kept or groups)
  return dataclasses.replace(table, notes=(*notes, *table.notes), withheld=withheld)


def _each_stamp_once(group: Clocked) -> tuple[Clocked, np.ndarray]:
  """The group without samples that repeat a stamp, and their rows; whole where they are many: such a clock lacks
  digits."""
  again = np.flatnonzero(np.diff(group.time) == 0.0) + 1
  if again.size > FEW * group.time.size:
    return group, NO_ROWS
  without = lambda values: np.delete(values, again)
  return Clocked(without(group.time), {name: without(values) for name, values in group.columns.items()}), again
