"""How a text file is written: separator, decimal mark, encoding, and which lines above the numbers name the columns."""

from __future__ import annotations

import csv
import dataclasses
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from qcar_twin.recordings.formats.text.encodings import LONGEST_LINE, encoding_of
from qcar_twin.recordings.formats.text.groups import is_number, marks_of
from qcar_twin.recordings.formats.text.heads import motion_capture, stated_rate
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import BRACKET, UNITS, unit_of

_SEPARATORS = "\t;,"  # of two that are in every row the first: a comma may be a decimal mark
SPACES = " "  # the separator of a text whose columns any number of blanks is between
_MANY = 20  # rows of a log: nobody drives for fewer
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
    rate: of the rows, Hz, where the lines above them state it.
    groups: marks that may part the thousands of a number, each of them alone.
    clock, began: the column that counts from a date, and that date, s since 1970, where the lines above them state it.
  """

  separator: str
  decimal: str
  encoding: str
  skipped: int
  names: tuple[str, ...] = ()
  headless: bool = False
  rate: float | None = None
  groups: str = ""
  clock: str = ""
  began: float = 0.0


def dialect_of(path: Path, label: str) -> Dialect:
  """From the lines above the numbers and the first rows of them.

  Lines that begin with # are comments; the last of them is the header where nothing else is, or the last but one, where
  the last has units. Lines of another number of cells than the rows have are a preamble. Of several lines above the
  numbers the first whose cells are all there and differ has the names, and one of units below it goes into them:
  `speed [km/h]`.

  Raises:
    RecordingError: it is no text, or its first line has no end.
  """
  lines, encoding = _first_lines(path, label)
  if (capture := motion_capture(lines)) is not None:
    return Dialect(
      ",", ".", encoding, capture.lines, capture.names, rate=capture.rate,
      clock="" if capture.began is None else capture.clock, began=capture.began or 0.0,
    )  # fmt: skip
  return _of_lines(lines, encoding)


def holds_samples(path: Path) -> bool:
  """Whether a text is a table, by its first lines: many rows of as many numbers, not more lines of anything else."""
  try:
    lines, _ = _first_lines(path, path.name)
  except RecordingError:
    return False
  content = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
  if len(content) < _MANY:
    return False
  separator, wide = _separator(content[min(_SAMPLE, len(content) - 1)])
  cells = [_cells(line, separator) for line in content]
  rows = sum(len(row) == wide and _mostly(row, _number) for row in cells)
  return wide > 1 and rows >= _MANY and rows > _MOSTLY * len(content)


def _first_lines(path: Path, label: str) -> tuple[list[str], str]:
  """The lines that a file begins with, and its encoding; RecordingError where it is no text, or has no lines."""
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
  return lines, encoding


def _of_lines(lines: Sequence[str], encoding: str) -> Dialect:
  """The same of the lines of any other tool."""
  filled = [k for k, line in enumerate(lines) if line.strip()]
  content = [k for k in filled if not lines[k].lstrip().startswith("#")] or filled
  if not content:
    return Dialect(",", ".", encoding, 0)
  separator, wide = _separator(lines[content[min(_SAMPLE, len(content) - 1)]])
  cells = {k: _cells(lines[k], separator) for k in filled}
  content = sorted({*content, *(k for k in filled if _counts_rows(cells[k], wide))})
  first = next((k for k in content if len(cells[k]) == wide and _mostly(cells[k], _number)), None)
  above = [] if first is None else _stack([k for k in content if k < first], cells, wide)
  commented = [k for k in filled if k < (content[0] if first is None else first) and k not in content]
  rate = None if first is None else stated_rate([lines[k] for k in filled if k < first])
  if first is None or (not above and first != content[0]):
    above, first = [content[0]], content[min(1, len(content) - 1)]
  if not above:
    above = _nearest(_stack(commented, cells, wide), cells)
  elif separator == SPACES:
    above = _nearest(above, cells)
  likely = "," if any(map(_COMMA.match, cells[first])) else "."
  decimal, groups = marks_of((cells[k] for k in content if k >= first), likely)
  if not above:
    below = cells[content[min(content.index(first) + 1, len(content) - 1)]]
    samples = all(_number(one) or not _number(other) for one, other in zip(cells[first], below, strict=False))
    return Dialect(separator, decimal, encoding, first, headless=samples, rate=rate, groups=groups)
  names = _names([cells[k] for k in above]) if len(above) > 1 else ()
  return Dialect(separator, decimal, encoding, first if names else above[0], names, rate=rate, groups=groups)


def _separator(sample: str) -> tuple[str, int]:
  """What is between the columns of a line of numbers, and how many cells it has."""
  separator = next((mark for mark in _SEPARATORS if mark in sample), ",")
  if separator not in sample and len(sample.split()) > 1 and _mostly(sample.split(), _number):
    separator = SPACES
  return separator, len(_cells(sample, separator))


def _nearest(lines: Sequence[int], cells: dict[int, list[str]]) -> list[int]:
  """The last of some lines above the numbers, with the one above it where it has units: of comments, and of lines in
  which blanks part words, the others are sentences by chance of as many words as there are columns."""
  last = list(lines[-2:])
  return last if len(last) < 2 or _mostly([_bare(cell) for cell in cells[last[1]]], _unit) else last[1:]


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
    return is_number(cell)
  return True


def _unit(cell: str) -> bool:
  word = cell.strip().strip("[](){}").lower()
  return word in UNITS or word in _NO_UNIT


def _counts_rows(cells: Sequence[str], wide: int) -> bool:
  """Whether a line that begins with # is one of units, the first of which says that its column numbers the rows."""
  return len(cells) == wide > 1 and cells[0].strip() == "#" and _mostly(cells[1:], _unit)


def _mostly(cells: Sequence[str], is_one: Callable[[str], bool]) -> bool:
  there = [cell for cell in cells if cell.strip()]
  return bool(there) and sum(map(is_one, there)) > _MOSTLY * len(there)


def _bare(cell: str) -> str:
  """Without the mark of a comment."""
  return cell.strip().lstrip("# \t")


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
  rows = [[_bare(cell) if not k else cell.strip() for k, cell in enumerate(row)] for row in rows]
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
  """Names with the units that stand below them, where they say none themselves or another one by their words alone: a
  `v_Rad` over km/h is in km/h."""
  of = lambda cell: cell.strip("[](){}")
  says = lambda name, cell: cell.lower() in _NO_UNIT or not cell or _says(name, of(cell))
  return tuple(name if says(name, cell) else f"{name} [{of(cell)}]" for name, cell in zip(names, units, strict=True))


def _says(name: str, unit: str) -> bool:
  """Whether a name has a unit in brackets, or its words are this unit."""
  said = unit_of(name)
  return said is not None and (bool(BRACKET.search(name)) or said[1:] == UNITS.get(unit.lower(), ()))
