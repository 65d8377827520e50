"""What stands above the numbers of a text table beside its names: motion capture's bodies and units, a stated rate.

OptiTrack's Motive writes one line of properties, then a row each of what the columns belong to (Type, Name, ID), of
what they are (Rotation, Position) and of axes (its documentation, "Data Export: CSV"). Vicon's Tracker and Nexus write
a word, the rate in Hz, a row of subjects above the first column of each, then names and units ("ASCII export").
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

from qcar_twin.recordings.formats.dates import seconds_of

_LINES = 12  # within which the head of a motion capture's export is over
_VICON = {"objects", "segments", "trajectories", "joints", "model outputs"}
_LENGTHS = {"millimeters": "mm", "centimeters": "cm", "meters": "m", "inches": "inch", "feet": "ft"}
_OF_LENGTH = {"Position", "Mean Marker Error"}
_MOTIVE_TIME = re.compile(r"^(\d{4})-(\d{2})-(\d{2}) (\d{2})\.(\d{2})\.(\d{2}(?:\.\d+)?)(?: ([AP]M))?$")
_MOTIVE_CLOCK = "Time (Seconds)"
_RATE = re.compile(
  r"^[\W_]*(?:(?:(?:sample|sampling|frame|log|logging|logger|data|update|recording|record|export)[ _-]?)?"
  r"(?:rate|frequency|freq)|fs|f_s|abtastrate|abtastfrequenz|messrate|fr[ée]quence d['’][ée]chantillonnage"
  r"|frecuencia de muestreo|frequenza di campionamento)"
  r"[\s\"]*(?:[\[(](?P<beside>k?hz|1/s)[\])])?[\s\"]*[:=,;\s][\s\"]*(?P<value>\d+(?:[.,]\d+)?)"
  r"[\s\",;]*(?P<unit>k?hz|1/s|sps|samples/s)?[\s\",;.]*$",
  re.IGNORECASE,
)


@dataclass(frozen=True)
class Head:
  """What a motion capture's head says.

  Attributes:
    names: of the columns, `body.Position.X [mm]`.
    lines: that the head takes.
    rate: of the rows, Hz; None where it is not stated.
    began: s since 1970 at 0 of the column `clock`; None where it is not stated.
    clock: the column that counts from there.
  """

  names: tuple[str, ...]
  lines: int
  rate: float | None = None
  began: float | None = None
  clock: str = ""


def motion_capture(lines: Sequence[str]) -> Head | None:
  """The head of a file of Motive's or Vicon's that begins with these lines; None where it is none, or not whole."""
  rows = [[cell.strip() for cell in next(csv.reader([line]), [])] for line in lines[:_LINES]]
  if not rows or not rows[0]:
    return None
  if rows[0][0] == "Format Version":
    return _motive(rows)
  return _vicon(rows) if rows[0][0].lower() in _VICON and not any(rows[0][1:]) else None


def stated_rate(lines: Sequence[str]) -> float | None:
  """Hz that one of the lines above the numbers states, and none of them otherwise: `# rate: 100 Hz`, `Sample
  Rate,100,Hz`. None where none does; the rate of one sensor or of a serial line is not that of the rows."""
  rates = set()
  for match in filter(None, map(_RATE.match, lines)):
    unit = (match["unit"] or match["beside"] or "").lower()
    rates.add(float(match["value"].replace(",", ".")) * (1e3 if unit == "khz" else 1.0))
  return rates.pop() if len(rates) == 1 and min(rates) > 0.0 else None


def _motive(rows: Sequence[list[str]]) -> Head | None:
  said = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
  last = next((k for k, row in enumerate(rows) if row[:1] == ["Frame"]), None)
  above = [row for row in rows[1:last] if any(row)]
  # before format version 1.23 the rows of types, names and numbers are not called so
  unnamed = above[1] if len(above) > 1 and not any(above[1][:2]) else None
  owners = next((row for row in above if row[1:2] == ["Name"]), unnamed)
  if last is None or owners is None or not len(owners) == len(rows[last]) == len(rows[last - 1]):
    return None
  length = _LENGTHS.get(said.get("Length Units", "").lower())
  turned = "" if said.get("Rotation Type", "Quaternion") == "Quaternion" else " [deg]"
  names = []
  for owner, what, axis in zip(owners[2:], rows[last - 1][2:], rows[last][2:], strict=True):
    unit = f" [{length}]" if length and what in _OF_LENGTH else turned if what == "Rotation" else ""
    names.append(".".join(filter(None, (owner, what, axis))) + unit)
  return Head(
    (*rows[last][:2], *names), last + 1, _positive(said.get("Export Frame Rate", "")),
    _since_1970(said.get("Capture Start Time", "")), _MOTIVE_CLOCK,
  )  # fmt: skip


def _vicon(rows: Sequence[list[str]]) -> Head | None:
  last = next((k for k, row in enumerate(rows) if row[:1] == ["Frame"]), None)
  rate = _positive(rows[1][0]) if len(rows) > 1 and rows[1] else None
  if last is None or rate is None or last + 1 >= len(rows) or len(rows[last + 1]) != len(rows[last]):
    return None
  owners, owner, names = rows[last - 1], "", []
  for k, (name, unit) in enumerate(zip(rows[last], rows[last + 1], strict=True)):
    owner = (owners[k] if k < len(owners) else "") or owner
    names.append(".".join(filter(None, (owner, name))) + (f" [{unit}]" if unit else ""))
  return Head(tuple(names), last + 2, rate)


def _positive(text: str) -> float | None:
  try:
    value = float(text)
  except ValueError:
    return None
  return value if value > 0.0 else None


def _since_1970(text: str) -> float | None:
  """s of a time such as `2023-06-21 03.04.11.250 PM`, as the clock on the wall had it; None where it is no such."""
  if (match := _MOTIVE_TIME.match(text)) is None:
    return None
  year, month, day, hour, minute, second, half = match.groups()
  seconds = seconds_of([f"{year}/{month}/{day} {hour}:{minute}:{second} {half or ''}"])
  return None if seconds is None else float(seconds[0])
