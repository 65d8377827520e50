"""A log file in memory: named columns of one length, blank cells as NaN."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.recording import RecordingError, nearest

NO_ROWS = np.empty(0, dtype=int)
_SHOWN_COLUMNS = 40


@dataclass(frozen=True, eq=False)
class Table:
  """Columns (rows,) as read. Float columns have NaN for a blank cell; text columns are kept to name the bad row.

  `not_a_number`: per column, the rows where the file itself says NaN instead of leaving the cell blank.
  `ambiguous`: column names that occur more than once.
  `blanks`: whether the format can tell a blank cell from a NaN (CSV and Parquet can, NPZ and MAT cannot).
  """

  label: str
  columns: Mapping[str, np.ndarray]
  not_a_number: Mapping[str, np.ndarray]
  ambiguous: frozenset[str] = frozenset()
  blanks: bool = True

  @property
  def rows(self) -> int:
    return max((column.size for column in self.columns.values()), default=0)

  def __contains__(self, column: object) -> bool:
    return column in self.columns

  def number(self, column: str, channel: str) -> np.ndarray:
    """A numeric column (rows,). Raises RecordingError when it is missing, occurs twice, or holds text."""
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

  def listing(self) -> str:
    """The names of the columns, for an error text; the first forty when there are more."""
    names = list(self.columns)
    more = f", and {len(names) - _SHOWN_COLUMNS} more" if len(names) > _SHOWN_COLUMNS else ""
    return ", ".join(names[:_SHOWN_COLUMNS]) + more

  def _text_complaint(self, column: str, channel: str, values: np.ndarray) -> str:
    row, cell = next((row, cell) for row, cell in enumerate(values) if not _is_number(cell))
    about = f"column '{column}'" + (f" for {channel}" if column != channel else "")
    cure = "write numbers with a decimal point, or leave the cell blank where there is no sample"
    if channel == "time":
      cure = "time must be a number of seconds in every row"
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
  return True


@dataclass(frozen=True, eq=False)
class Clocked:
  """Columns (k,) that share one clock `time` (k,), s: a topic of a bag, a structure with time."""

  time: np.ndarray
  columns: Mapping[str, np.ndarray]


def merge(label: str, groups: Sequence[Clocked]) -> Table:
  """One table from groups with clocks of their own: every time once, in column `time`; NaN where there is no sample.

  Raises RecordingError when a group's own clock goes backwards, repeats or has no value.
  """
  for group in groups:
    name = next(iter(group.columns), "time")
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
  return Table(label, columns, gaps)
