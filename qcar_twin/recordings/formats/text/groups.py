"""Numbers whose thousands are grouped, 3.214 beside 0,5 or 1,234.5, and which mark of a text is that of decimals."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
import pyarrow
import pyarrow.compute

from qcar_twin.recordings.recording import RecordingError

APART = "'\u2019 \u00a0\u2009\u202f"  # apostrophes and spaces that part groups, and never are a mark of decimals
_OTHER = {",": ".", ".": ","}  # by mark of decimals the one that may part groups
_CALLED = {",": "comma", ".": "dot"}
_POWER = r"(?:[eE][-+]?[0-9]+)?"
_DIGITS = rf"^\s*[-+]?[0-9.,]*[0-9][.,]?{_POWER}\s*$"  # a number, or one with marks where none belong
_NONE = r"^\s*[-+]?(?:inf|nan|NaN)\s*$"


def _grouped(marks: str) -> str:
  """What whole numbers look like in groups of three digits: 1.234, never 0.123 or 12.5."""
  return rf"[1-9][0-9]{{0,2}}(?:{'|'.join(rf'(?:{re.escape(mark)}[0-9]{{3}})+' for mark in marks)})"


def _whole(decimal: str, marks: str) -> str:
  """What a cell with a number looks like, with groups or without."""
  point = re.escape(decimal)
  return rf"^\s*[-+]?(?:(?:[0-9]+|{_grouped(marks)})(?:{point}[0-9]*)?|{point}[0-9]+){_POWER}\s*$"


_EITHER = [re.compile(_whole(decimal, other + APART)) for decimal, other in _OTHER.items()]
# a cell that shows which mark is that of decimals: 0,5 or 1.234,5, not 1,234
_SHOWS = {
  decimal: re.compile(
    rf"^\s*[-+]?(?!{_grouped(decimal)}\s*$)(?:[0-9]*|{_grouped(other + APART)}){re.escape(decimal)}[0-9]+{_POWER}\s*$"
  )
  for decimal, other in _OTHER.items()
}


def is_number(cell: str) -> bool:
  """Whether a cell is a number with either mark of decimals, its thousands in groups or not."""
  return any(pattern.match(cell) for pattern in _EITHER)


def marks_of(rows: Iterable[Sequence[str]], likely: str) -> tuple[str, str]:
  """The mark of decimals, and those that part groups. Where cells show one mark alone, that is it, else the `likely`
  one; the other parts groups where more cells show the first than the other."""
  seen = {cell for row in rows for cell in row if "," in cell or "." in cell}
  shown = Counter(mark for cell in seen for mark, pattern in _SHOWS.items() if pattern.match(cell))
  decimal = next(iter(shown)) if len(shown) == 1 else likely
  return decimal, APART + (_OTHER[decimal] if shown[decimal] > shown[_OTHER[decimal]] else "")


def without_groups(table: pyarrow.Table, decimal: str, marks: str, label: str) -> pyarrow.Table:
  """The table with numbers in columns that are text for the groups of their cells alone.

  Raises:
    RecordingError: such a column has a cell with a mark that parts no groups.
  """
  for k, (name, column) in enumerate(zip(table.column_names, table.columns, strict=True)):
    if not marks or not pyarrow.types.is_string(column.type):
      continue
    number, none, digits = (_matches(column, like) for like in (_whole(decimal, marks), _NONE, _DIGITS))
    if not (number | none | digits).all():
      continue
    if (bad := np.flatnonzero(~(number | none))).size:
      if _OTHER[decimal] in marks and (number & _matches(column, "[.,]")).any():
        raise RecordingError(_complaint(label, name.strip(), str(column[int(bad[0])]), int(bad[0]) + 1, decimal))
      continue
    away = str.maketrans(decimal, ".", marks)
    values = [np.nan if cell is None else float(cell.strip().translate(away)) for cell in column.to_pylist()]
    blank = column.is_null().to_numpy()
    table = table.set_column(k, name, pyarrow.array(np.array(values, dtype=float), mask=blank))
  return table


def _matches(column: pyarrow.ChunkedArray, like: str) -> np.ndarray:
  """Per row, (rows,), whether a cell looks like that; blank ones do."""
  flags = pyarrow.compute.call_function("match_substring_regex", [column], pyarrow.compute.MatchSubstringOptions(like))
  return flags.fill_null(True).to_numpy()


def _complaint(label: str, name: str, cell: str, row: int, decimal: str) -> str:
  other = _OTHER[decimal]
  return (
    f"{label}: column '{name}' has '{cell.strip()}' in row {row}: numbers of this file have a {_CALLED[decimal]} before"
    f" their decimals, and its {_CALLED[other]} parts groups of three digits, as in 3{other}214{decimal}5; write the"
    f" cells of that column with one mark, that before the decimals, and without groups"
  )
