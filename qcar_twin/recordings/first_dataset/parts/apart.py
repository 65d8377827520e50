"""Files in which a logger began again, or that hold all runs one below the other, as one table for each run."""

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from qcar_twin.recordings.first_dataset.columns import Columns, guess_columns
from qcar_twin.recordings.first_dataset.parts.joined import Joined
from qcar_twin.recordings.first_dataset.parts.torn import MANY
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.unit_names import words_of

_AGAIN = 1.0  # s after a file's first time, before which a clock that began again begins
_RUNS = {
  "run", "runs", "trial", "take", "session", "experiment", "recording", "drive", "episode", "test", "measurement",
}  # fmt: skip


def runs_apart(tables: Sequence[Table]) -> Joined:
  """The tables, those whose clock begins again as one for each run. A run is called after the column that names it, as
  `drives_R01.csv`, else by its number.

  A clock that falls to any other time, or for a few rows, is a damaged one, and stays for the checks to name.
  """
  whole: list[Table] = []
  made: list[Table] = []
  said: list[str] = []
  for table in tables:
    cuts = _beginnings(table)
    if len(cuts) < 2:
      whole.append(table)
      continue
    ends = [*cuts[1:], table.rows]
    names, column = _names(table, cuts, ends)
    path = PurePosixPath(table.label)
    for first, last, name in zip(cuts, ends, names, strict=True):
      made.append(_piece(table, first, last, str(path.with_name(f"{path.stem}_{name}.csv"))))
    by = f", called after '{column}'" if column else ""
    said.append(f"{table.label}: its clock begins again in row {cuts[1] + 1}; read as {len(cuts)} runs{by}")
    said += table.notes
  return Joined((*whole, *made), tuple(made), tuple(said))


def _beginnings(table: Table) -> list[int]:
  """The rows in which a run begins; the first one alone where the file is one run."""
  if table.headless or table.rows < 2 * MANY:
    return [0]
  columns = Columns((table,))
  clock = guess_columns(columns).get("time")
  if clock is None or clock.steps or clock.sort:
    return [0]
  time = clock.scale * columns.tables[0].number(clock.column, "time")
  cuts = [0, *(np.flatnonzero(np.diff(time) < 0.0) + 1).tolist()]
  long = np.diff([*cuts, table.rows]).min() >= MANY
  return cuts if long and (time[cuts] <= time[0] + _AGAIN).all() else [0]


def _names(table: Table, cuts: Sequence[int], ends: Sequence[int]) -> tuple[list[str], str]:
  """What each run is called, and the column that says so: one that stays within a run and differs between them."""
  for column, values in table.columns.items():
    if not set(words_of(column)) & _RUNS:
      continue
    each = [set(values[first:last].tolist()) for first, last in zip(cuts, ends, strict=True)]
    called = [_plain(next(iter(one))) for one in each]
    if all(len(one) == 1 for one in each) and all(called) and len(set(called)) == len(called):
      return called, column
  return [str(number) for number in range(1, len(cuts) + 1)], ""


def _plain(value: object) -> str:
  """A value as a file's name may have it; empty where there is none."""
  text = f"{value:g}" if isinstance(value, float) else str(value or "")
  return re.sub(r"[^\w-]+", "_", text).strip("_")


def _piece(table: Table, first: int, last: int, label: str) -> Table:
  rows = table.rows_between(first, last)
  return Table(label, rows.columns, rows.not_a_number, table.ambiguous, unsigned=table.unsigned)
