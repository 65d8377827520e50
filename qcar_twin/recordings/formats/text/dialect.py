"""How a text file is written: separator, decimal mark, encoding, and which lines above the numbers name the columns."""

from __future__ import annotations

import csv
import dataclasses
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from qcar_twin.recordings.formats.text.encodings import LONGEST_LINE, encoding_of
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import UNITS, unit_of

_SEPARATORS = "\t;,"  # of two that are in every row the first: a comma may be a decimal mark
SPACES = " "  # the separator of a text whose columns any number of blanks is between
_SAMPLE = 40  # lines below which a preamble is over
_MOSTLY = 0.5  # of the cells that are there: numbers make a row of samples, units one of units
_COMMA = re.compile(r"^\s*[-+]?\d+,\d+(?:[eE][-+]?\d+)?\s*$")
_NO_UNIT = {"-", "1", "[-]", "none", "n/a"}


@dataclasses.dataclass(frozen=True)
class Dialect:
  """How a text file is written.

  Attributes:
    separator, decimal: marks between and within numbers.
    encoding: of the text, without a mark of byte order.
    skipped: lines above the header, or above the samples where `names` are given.
    names: of the columns, where more than one line says them; else the first line that is not skipped does.
    headless: the first line holds numbers.
  """

  separator: str
  decimal: str
  encoding: str
  skipped: int
  names: tuple[str, ...] = ()
  headless: bool = False


def dialect_of(path: Path, label: str) -> Dialect:
  """From the lines above the numbers and the first rows of them.

  Lines that begin with # are comments; the last of them is the header where nothing else is. Lines of another number of
  cells than the rows have are a preamble. Of several lines above the numbers the first whose cells are all there and
  differ has the names, and one of units below it goes into them: `speed [km/h]`.

  Raises:
    RecordingError: it is no text, or its first line has no end.
  """
  with path.open("rb") as file:
    head = file.read(LONGEST_LINE)
  encoding = encoding_of(head)
  if not encoding.startswith("utf-16") and b"\x00" in head:
    raise RecordingError(f"{label}: is no text, or damaged: it holds zero bytes; save it as CSV UTF-8")
  text = head.decode(encoding, errors="ignore")
  if len(head) == LONGEST_LINE and not text.strip().count("\n") and "\r" not in text.strip():
    raise RecordingError(
      f"{label}: the first line has more than {LONGEST_LINE >> 10} KiB and is no header; write one line of names and"
      " one line a sample"
    )
  lines = text.splitlines()
  lines = lines[:-1] if len(head) == LONGEST_LINE and len(lines) > 1 else lines  # the last is cut off
  filled = [k for k, line in enumerate(lines) if line.strip()]
  content = [k for k in filled if not lines[k].lstrip().startswith("#")] or filled
  if not content:
    return Dialect(",", ".", encoding, 0)
  sample = lines[content[min(_SAMPLE, len(content) - 1)]]
  separator = next((mark for mark in _SEPARATORS if mark in sample), ",")
  if separator not in sample and len(sample.split()) > 1 and _mostly(sample.split(), _number):
    separator = SPACES
  cells = {k: _cells(lines[k], separator) for k in content}
  wide = len(_cells(sample, separator))
  first = next((k for k in content if len(cells[k]) == wide and _mostly(cells[k], _number)), None)
  above = [] if first is None else _stack([k for k in content if k < first], cells, wide)
  commented = [k for k in filled if k < (content[0] if first is None else first) and k not in content]
  if first is None or (not above and first != content[0]):
    above, first = [content[0]], content[min(1, len(content) - 1)]
  if not above and commented and len(_cells(lines[commented[-1]], separator)) == wide:
    above = [commented[-1]]  # the header is the last of the comments
  decimal = "," if any(map(_COMMA.match, _cells(lines[first], separator))) else "."
  if not above:
    below = cells[content[min(content.index(first) + 1, len(content) - 1)]]
    samples = all(_number(one) or not _number(other) for one, other in zip(cells[first], below, strict=False))
    return Dialect(separator, decimal, encoding, first, headless=samples)
  names = _names([_cells(lines[k], separator) for k in above]) if len(above) > 1 else ()
  return Dialect(separator, decimal, encoding, first if names else above[0], names)


def without_comments(text: str, skipped: int) -> str:
  """The lines from there on that do not begin with #, but for the first, which may be a header so marked."""
  lines = text.splitlines(keepends=True)[skipped:]
  return "".join(line for k, line in enumerate(lines) if not k or not line.lstrip().startswith("#"))


def by_tabs(text: str) -> str:
  """A text with blanks between its columns, by tabs; the mark of a comment is no column's."""
  lines = (re.sub(r"^\s*#\s+", "#", line) for line in text.splitlines())
  return "".join("\t".join(line.split()) + "\n" for line in lines)


def _cells(line: str, separator: str) -> list[str]:
  if separator == SPACES:
    return re.sub(r"^\s*#\s+", "#", line).split()
  return next(csv.reader([line], delimiter=separator), [])


def _number(cell: str) -> bool:
  try:
    float(cell)
  except ValueError:
    return bool(_COMMA.match(cell))
  return True


def _unit(cell: str) -> bool:
  word = cell.strip().strip("[](){}").lower()
  return word in UNITS or word in _NO_UNIT


def _mostly(cells: Sequence[str], is_one: Callable[[str], bool]) -> bool:
  there = [cell for cell in cells if cell.strip()]
  return bool(there) and sum(map(is_one, there)) > _MOSTLY * len(there)


def _stack(above: Sequence[int], cells: dict[int, list[str]], wide: int) -> list[int]:
  """The lines right above the samples that have as many cells."""
  kept: list[int] = []
  for k in reversed(above):
    if len(cells[k]) != wide:
      break
    kept.insert(0, k)
  return kept


def _names(rows: Sequence[list[str]]) -> tuple[str, ...]:
  """Names from several lines: the first that names every column by itself, with the units of the line below it; where
  none does, what the lines say of a column one after the other, with the units of the line that has them."""
  rows = [[cell.strip() for cell in row] for row in rows]
  units = next((k for k, row in enumerate(rows) if k and _mostly(row, _unit)), None)
  whole = next((k for k, row in enumerate(rows) if k != units and all(row) and len(set(row)) == len(row)), None)
  if whole is None:
    said = [row for k, row in enumerate(rows) if k != units]
    names = [" ".join(dict.fromkeys(filter(None, column))) for column in zip(*said, strict=True)]
    return tuple(names) if units is None else _with_units(names, rows[units])
  if whole + 1 == len(rows):
    return tuple(rows[whole])
  below = rows[whole + 1]
  if not _mostly(below, _unit):
    return ()  # words below a header are refused where the rows are looked at
  return _with_units(rows[whole], below)


def _with_units(names: Sequence[str], units: Sequence[str]) -> tuple[str, ...]:
  """Names with the units that stand below them, where they say none themselves."""
  of = lambda cell: cell.strip("[](){}")
  return tuple(
    f"{name} [{of(cell)}]" if _unit(cell) and cell.lower() not in _NO_UNIT and unit_of(name) is None else name
    for name, cell in zip(names, units, strict=True)
  )
