"""Lines that name each of their values, as a serial monitor's `t:20 st:0.1 gz:-0.3` or a CAN bus that cantools decoded.

`python -m cantools decode --single-line` writes a message a line, behind its stamp and its bytes (its documentation,
"The decode subcommand"): `(1658330000.02) can0 0A1 [8] EB 11 … :: Steering(Angle: 0.1 deg, Valid: 1)`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from qcar_twin.recordings.formats.table import Clocked, Table, merge_kinds
from qcar_twin.recordings.formats.text.encodings import LONGEST_LINE, encoding_of
from qcar_twin.recordings.unit_names import UNITS

_VALUE = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PAIR = re.compile(
  rf"(?<![\w.])\"?(?P<name>[A-Za-z_][\w./\[\]]*)\"?\s?[:=]\s?\"?(?P<value>{_VALUE}|nan|NaN)\"?"
  r"(?:\s?(?P<unit>[A-Za-z°%][\w°%/^²-]*))?(?=[\s,;|)}\]]|$)"
)
_STAMP = re.compile(rf"^\s*[(\[]\s*(?P<time>{_VALUE})\s*[)\]]")
_BODY = " :: "  # of cantools, behind a message's bytes
_FEWEST, _MANY, _SAMPLE = 2, 20, 60  # pairs of a line, lines of a log, and those by which a file is judged


def names_its_values(path: Path) -> bool:
  """Whether most of a text's first lines are values with their names."""
  with path.open("rb") as file:
    head = file.read(LONGEST_LINE)
  lines = [line for line in head.decode(encoding_of(head), errors="ignore").splitlines() if line.strip()][:_SAMPLE]
  return sum(len(_pairs(line)) >= _FEWEST for line in lines) > max(0.5 * len(lines), _MANY)


def keyed_lines(path: Path, label: str) -> Table | None:
  """The values as columns by their names, a row a line; of messages of several kinds each on the stamps in front of its
  lines. Lines of other names than most, as torn ones have, are left out with a note. None for any other text."""
  if not names_its_values(path):
    return None
  data = path.read_bytes()
  kinds: dict[tuple[str, ...], list[tuple[float, list[float]]]] = {}
  lines = 0
  for line in data.decode(encoding_of(data[:LONGEST_LINE]), errors="replace").splitlines():
    pairs, stamp = _pairs(line), _STAMP.match(line)
    if pairs:
      lines += 1
      rows = kinds.setdefault(tuple(pairs), [])
      rows.append((float(stamp["time"]) if stamp else np.nan, list(pairs.values())))
  stamped = all(np.isfinite(time) for rows in kinds.values() for time, _ in rows)
  whole = {names: rows for names, rows in kinds.items() if len(rows) >= _MANY}
  if not stamped:
    names = max(whole, key=lambda each: len(whole[each]), default=None)
    return None if names is None else _table(label, names, whole[names], lines)
  return merge_kinds(label, [_message(names, rows) for names, rows in whole.items()]) if whole else None


def _pairs(line: str) -> Mapping[str, float]:
  """By its name, with its unit in brackets, each value that a line names; of messages with the message's name."""
  message, _, body = line.rpartition(_BODY)
  kind = f"{body.partition('(')[0].strip()}." if message and "(" in body else ""
  named = {}
  for pair in _PAIR.finditer(body):
    unit = f" [{pair['unit']}]" if pair["unit"] and pair["unit"].lower() in UNITS else ""
    named[f"{kind}{pair['name']}{unit}"] = float(pair["value"])
  return named


def _table(label: str, names: Sequence[str], rows: Sequence[tuple[float, list[float]]], lines: int) -> Table:
  columns = dict(zip(names, np.array([values for _, values in rows]).T, strict=True))
  others = lines - len(rows)
  notes = (f"{label}: {others} of {lines} lines have other names than most; left out",) if others else ()
  return Table(label, columns, {name: np.flatnonzero(np.isnan(v)) for name, v in columns.items()}, notes=notes)


def _message(names: Sequence[str], rows: Sequence[tuple[float, list[float]]]) -> Clocked:
  time = np.array([stamp for stamp, _ in rows])
  order = np.argsort(time, kind="stable")
  columns = np.array([values for _, values in rows])[order].T
  return Clocked(time[order], dict(zip(names, columns, strict=True)))
