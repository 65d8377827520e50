"""Files of RaceLogic's VBOX, `.vbo`: text in sections, of which `[column names]` says what the rows of `[data]` hold.

What the usual channels count stands in its maker's support pages ("VBO File Format"): the time of day as HHMMSS.ss in
UTC, latitude in minutes to the north and longitude in minutes to the west, heading in degrees clockwise from north.
`[channel units]` has the units of the channels behind those, in their order; a title of `[header]` may end with one, as
in `velocity kmh`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.formats.text.encodings import LONGEST_LINE, encoding_of
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import UNITS

_NAMES, _TITLES, _UNITS, _DATA = "[column names]", "[header]", "[channel units]", "[data]"
_TIME, _LATITUDES, _LONGITUDES = "time", ("lat", "latitude"), ("long", "longitude")
# what a channel is called in a table, and its unit where no title says it; a heading is that of the way it went
_CALLED = {
  **dict.fromkeys(_LATITUDES, "latitude [deg]"),
  **dict.fromkeys(_LONGITUDES, "longitude [deg]"),
  _TIME: "time [s]",
  "heading": "gps.heading [deg]",
  "height": "height [m]",
}
_DEFAULTS = {"velocity": "km/h"}
_WITHOUT_UNITS = {  # channels that [channel units] leaves out
  *_CALLED, "sats", "satellites", "velocity", "vert-vel", "vertvel", "event-1", "event1", "tsample", "solution_type",
  "avifileindex", "avisynctime", "avitime",
}  # fmt: skip
_WRITTEN = {"kmh": "km/h"}  # in titles
_NONE = ("", "-", "(null)", "null")  # a unit that is none
_DAY, _HOURS, _SIXTY, _MINUTES = 86400.0, 24, 60, 60.0  # s; of a day, of an hour and of a minute; of a degree
_POLE, _HALF = 90.0 * _MINUTES, 180.0 * _MINUTES  # minutes, beyond which there is no latitude and no longitude
_TORN = 0.005  # a stated prior, as of other tables: of rows, those that lost cells
_SHOWN = 40  # characters of a row or a cell


def read_vbo(path: Path, label: str) -> Table:
  """A VBOX's channels, `YawRate [deg/s]`: the time in s from midnight, which goes on over the next, places in degrees
  to the north and to the east."""
  data = path.read_bytes()
  sections = _sections(data.decode(encoding_of(data[:LONGEST_LINE]), errors="replace"), label)
  names = _names(sections, label)
  values, numbers, notes = _rows(sections[_DATA], names, label)
  units = _units(sections, names)
  columns: dict[str, np.ndarray] = {}
  ambiguous = set()
  for name, column in zip(names, values.T, strict=True):
    if np.isnan(column).all() and column.size:
      continue  # _rows has a note
    usual = name.lower()
    called = _CALLED.get(usual) or (f"{name} [{units[name]}]" if name in units else name)
    if usual == _TIME:
      column = _seconds(column, numbers, label)
    elif usual in (*_LATITUDES, *_LONGITUDES):
      column = _degrees(column, numbers, usual in _LATITUDES, label)
    if called in columns and not np.array_equal(columns[called], column, equal_nan=True):
      ambiguous.add(called)
    columns[called] = column
  gone = {name: np.flatnonzero(np.isnan(column)) for name, column in columns.items()}
  return Table(label, columns, gone, frozenset(ambiguous), notes=notes)


def _sections(text: str, label: str) -> dict[str, list[str]]:
  """The lines below each title in brackets."""
  sections: dict[str, list[str]] = {}
  lines: list[str] = []
  for line in text.splitlines():
    title = line.strip().lower()
    if title.startswith("[") and title.endswith("]"):
      if title in sections and title in (_NAMES, _DATA):
        raise RecordingError(f"{label}: has {title} twice, as two files in one; split it before the second")
      lines = sections.setdefault(title, [])
    else:
      lines.append(line)
  if _DATA not in sections:
    raise RecordingError(f"{label}: is no VBOX file: it has no section {_DATA}; write it again, or export it as .csv")
  return sections


def _names(sections: Mapping[str, Sequence[str]], label: str) -> list[str]:
  """The columns' names; of a file without them its channels' titles, without their units."""
  if names := " ".join(sections.get(_NAMES, ())).split():
    return names
  titles = [line.split() for line in sections.get(_TITLES, ()) if line.strip()]
  if not titles:
    raise RecordingError(f"{label}: names no columns; add a section {_NAMES} with a line of their names above {_DATA}")
  return ["_".join(words[: -1 if _unit(words) else None]) for words in titles]


def _unit(words: Sequence[str]) -> str:
  """The unit that a channel's title ends with."""
  return _WRITTEN.get(words[-1], words[-1]) if len(words) > 1 and words[-1].lower() in UNITS else ""


def _units(sections: Mapping[str, Sequence[str]], names: Sequence[str]) -> dict[str, str]:
  """Units by column: those listed are of the channels that are none of the usual, else of the last ones; a title's
  counts where none is listed."""
  units = {name: _DEFAULTS[name.lower()] for name in names if name.lower() in _DEFAULTS}
  titles = [line.split() for line in sections.get(_TITLES, ()) if line.strip()]
  if len(titles) == len(names):
    units |= {name: _unit(words) for name, words in zip(names, titles, strict=True) if _unit(words)}
  listed = "\n".join(sections.get(_UNITS, ())).strip().splitlines()
  channels = [name for name in names if name.lower() not in _WITHOUT_UNITS]
  if len(channels) != len(listed):
    channels = list(names[len(names) - len(listed) :]) if len(listed) <= len(names) else []
  said = {name: unit.strip() for name, unit in zip(channels, listed, strict=False)}
  return units | {name: unit for name, unit in said.items() if unit.lower() not in _NONE}


def _rows(lines: Sequence[str], names: Sequence[str], label: str) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
  """The numbers, (rows, columns), which rows they are, from 1, and notes on a few rows that lost cells and on columns
  of words, which are NaN.

  Raises:
    RecordingError: more rows than a few have another number of cells, or a cell among numbers is none.
  """
  rows = [line for line in lines if line.strip()]
  values = np.empty((len(rows), len(names)))
  torn: list[tuple[int, int]] = []
  words: dict[int, list[int]] = {}  # by column the rows in which it is no number
  kept = 0
  for number, row in enumerate(rows):
    cells = row.split()
    if len(cells) != len(names):
      torn.append((number, len(cells)))
      continue
    for place, cell in enumerate(cells):
      try:
        values[kept, place] = float(cell if "_" not in cell else "")  # Python takes 1_0 for a number
      except ValueError:
        values[kept, place] = np.nan
        words.setdefault(place, []).append(number)
    kept += 1
  for place, bad in words.items():
    if len(bad) < kept:
      raise RecordingError(
        f"{label}: column '{names[place]}' has '{rows[bad[0]].split()[place][:_SHOWN]}' in row {bad[0] + 1}, which is"
        " not a number; correct that cell, or delete the row"
      )
  if len(words) == len(names):
    raise RecordingError(f"{label}: {_DATA} holds no numbers; write it again, or export it as .csv")
  notes = [f"{label}: column '{names[place]}' holds no numbers; left out" for place in words]
  if torn:
    notes.append(_torn(torn, rows, len(names), label))
  whole = np.delete(np.arange(1, len(rows) + 1), [number for number, _ in torn])
  return values[:kept], whole, tuple(notes)


def _torn(torn: Sequence[tuple[int, int]], rows: Sequence[str], width: int, label: str) -> str:
  """A note on rows of another number of cells than there are names; RecordingError where they are more than a few."""
  number, cells = torn[0]
  shown = rows[number].strip()[:_SHOWN]
  said = f"row {number + 1} has {cells} cell{'s' * (cells != 1)} where {_NAMES} has {width} ('{shown}')"
  more = f" and {len(torn) - 1} more" if len(torn) > 1 else ""
  last = len(torn) == 1 and number == len(rows) - 1  # where a logger lost its power
  if len(torn) > _TORN * len(rows) and not (last and len(rows) > 1):
    raise RecordingError(f"{label}: a row does not fit its names: {said}{more}; repair or delete it")
  return f"{label}: {said}{more}; left out"


def _seconds(clock: np.ndarray, numbers: np.ndarray, label: str) -> np.ndarray:
  """Seconds from the midnight before the first row, of times of day HHMMSS.ss in UTC."""
  hours, rest = np.divmod(clock, 1e4)
  minutes, seconds = np.divmod(rest, 1e2)
  bad = (clock < 0.0) | (hours >= _HOURS) | (minutes >= _SIXTY) | (seconds > _SIXTY)
  if bad.any():
    row = int(np.argmax(bad))
    raise RecordingError(
      f"{label}: time is {clock[row]:.9g} in row {numbers[row]}, which is no time of day HHMMSS.ss;"
      " correct that row, or delete it"
    )
  time = np.round(3600.0 * hours + 60.0 * minutes + seconds, 6)
  there = np.isfinite(time)
  time[there] += _DAY * np.cumsum(np.diff(time[there], prepend=time[there][:1]) < -0.5 * _DAY)
  return time


def _degrees(minutes: np.ndarray, numbers: np.ndarray, latitude: bool, label: str) -> np.ndarray:
  """Degrees to the north, or to the east, of minutes to the north, or to the west."""
  bad = np.abs(minutes) > (_POLE if latitude else _HALF)
  if bad.any():
    row, what = int(np.argmax(bad)), "latitude" if latitude else "longitude"
    raise RecordingError(
      f"{label}: {what} is {minutes[row]:.9g} in row {numbers[row]}, and minutes of {what} are at most"
      f" {_POLE if latitude else _HALF:.0f}; correct that row, or delete it"
    )
  return (minutes if latitude else 0.0 - minutes) / _MINUTES
