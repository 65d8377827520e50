"""InfluxDB's line protocol, `.lp`: a point a line, `imu,car=a acc_x=0.1,ok=true 1719820800000000000`.

What a line may hold stands in InfluxData's documentation ("Line protocol"): a measurement and tags, which together are
a series, fields, and a stamp, which counts nanoseconds unless it was written in another precision. `influx_inspect
export` writes a line for every field, and comments above them.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from qcar_twin.recordings.clock_units import unit_of_clock
from qcar_twin.recordings.formats.table import NoSamples, Table
from qcar_twin.recordings.formats.text.encodings import LONGEST_LINE, encoding_of
from qcar_twin.recordings.formats.text.series import Series, table_of
from qcar_twin.recordings.recording import RecordingError

_SKIPPED = re.compile(r"[ \t\r]*+(?:(?:#|CREATE DATABASE )[^\n]*+)?(?:\n|\Z)")
_ESCAPED, _STRING = r"\\[^\n]", r'"(?:\\.|[^"\\])*+"'
_LINE = re.compile(
  rf"[ \t]*+(?P<series>(?:{_ESCAPED}|[^\\ \n])++) ++(?P<fields>(?:{_ESCAPED}|{_STRING}|[^\\\" \n])++)"
  r"(?: ++(?P<stamp>-?\d{1,19}+))?[ \t\r]*+(?:\n|\Z)",
  re.DOTALL,
)
_PART = re.compile(rf"(?:{_ESCAPED}|[^\\,])++")  # of a series: its measurement, a tag
_TAG = re.compile(rf"(?P<key>(?:{_ESCAPED}|[^\\=])++)=(?P<value>(?:{_ESCAPED}|[^\\=])++)")
_FIELD = re.compile(
  rf"(?P<key>(?:{_ESCAPED}|[^\\,=])++)="
  r"(?:(?P<number>[-+]?(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?)[iu]?"
  rf"|(?P<yes>t|T|true|True|TRUE)|(?P<no>f|F|false|False|FALSE)|(?P<text>{_STRING}))(?:,(?!\Z)|\Z)",
  re.DOTALL,
)
_MARK = re.compile(r"\\([,= ])")
_MOST = 10_000  # series of a file: measurements times drives times sensors
_LARGEST = 1 << 63  # of a stamp
_NANOSECOND = 1e-9  # s
_DATE, _FAR = 1e6, 100.0  # s, beyond which a stamp is a date's, and how far from the others none is
_SHOWN = 60  # characters of a line


def read_line_protocol(path: Path, label: str) -> Table:
  """A column `measurement.field` for every field of numbers and truth values, on the stamps of its own points, in s.

  Raises SeveralRecordings where a tag's values follow one another, as drives do.
  """
  data = path.read_bytes()
  text = data.decode(encoding_of(data[:LONGEST_LINE]), errors="replace")
  series, notes = _points(text, label)
  if not any(one.fields for one in series):
    raise NoSamples(f"{label}: holds no point with a number; export it again, or remove it from dataset.toml")
  return table_of(series, _scale(text, series, label), label, notes)


def _points(text: str, label: str) -> tuple[list[Series], list[str]]:
  """The series with their points, and a note on a last line that was cut off."""
  series: dict[str, Series] = {}
  notes: list[str] = []
  place, before = 0, ""
  while place < len(text):
    if (skipped := _SKIPPED.match(text, place)) is not None:
      place = skipped.end()
      continue
    line = _LINE.match(text, place)
    said = _complaint(line, before)
    if not said and line is not None:
      one = _series_of(line["series"], series)
      said = one if isinstance(one, str) else _add(one, line["fields"], int(line["stamp"]))
    if said:
      if not (before and "\n" not in text[place:]):
        raise RecordingError(f"{label}: {_shown(text, place)} {said}; repair or delete that line")
      notes.append(f"{label}: the last line is cut off ({_shown(text, place)}); left out")
      break
    assert line is not None
    place, before = line.end(), line["stamp"]
  return list(series.values()), notes


def _complaint(line: re.Match[str] | None, before: str) -> str:
  """What is wrong with a line as a whole: a stamp that was cut off has fewer digits than the one before."""
  if line is None:
    return "is no point, measurement,tag=value field=value stamp"
  if line["stamp"] is None:
    return "has no stamp, as where a database sets it on arrival"
  if abs(int(line["stamp"])) >= _LARGEST:
    return "has a stamp of more than 64 bits"
  return "has a stamp that is cut off" if not line[0].endswith("\n") and len(line["stamp"]) < len(before) else ""


def _series_of(said: str, known: dict[str, Series]) -> Series | str:
  """The series that a line begins with; in words what is wrong with it."""
  if said in known:
    return known[said]
  measurement, *parts = _PART.findall(said) or [""]
  tags = [_TAG.fullmatch(part) for part in parts]
  if said != ",".join([measurement, *parts]) or not measurement or not all(tags):
    return "has a tag that is not tag=value"
  if len(known) >= _MOST:
    return f"is of one more than {_MOST} series, so that a tag has a value for nearly every point; drop such tags"
  tagged = {_plain(tag["key"]): _plain(tag["value"]) for tag in tags if tag}
  return known.setdefault(said, Series(_plain(measurement), tagged))


def _add(series: Series, fields: str, stamp: int) -> str:
  """Put a point's fields into its series, all or none; in words what is wrong with one."""
  values: dict[str, float | None] = {}
  place = 0
  while place < len(fields):
    if (field := _FIELD.match(fields, place)) is None:
      return f"has a field that is no number, text or truth value ('{fields[place : place + _SHOWN]}')"
    number = 1.0 if field["yes"] else 0.0 if field["no"] else None
    values[_plain(field["key"])] = float(field["number"]) if field["number"] else number
    place = field.end()
  for name, value in values.items():
    series.add(name, stamp, value)
  return ""


def _plain(name: str) -> str:
  return _MARK.sub(r"\1", name) if "\\" in name else name


def _scale(text: str, series: list[Series], label: str) -> float:
  """The factor to s of all stamps: by their size where they are dates, else by their steps, ns where these say nothing.

  Raises:
    RecordingError: a stamp is of another precision than the others.
  """
  stamps = np.unique(np.concatenate([one.stamps() for one in series]))
  usual, steps = float(np.median(stamps)), np.diff(stamps)
  told = unit_of_clock("", float(np.median(steps)) if steps.size else 0.0, usual)
  scale = told[0] if told is not None and (steps.size or told[0] * usual > _DATE) else _NANOSECOND
  if scale * usual > _DATE:
    far = stamps[(stamps < usual / _FAR) | (stamps > usual * _FAR)]
    if far.size:
      stamp = re.search(rf" {far[0]}[ \t\r]*(?:\n|\Z)", text)
      place = text.rfind("\n", 0, stamp.start() if stamp else 0) + 1
      raise RecordingError(
        f"{label}: {_shown(text, place)} has the stamp {far[0]}, and others are near {usual:.4g}; write all stamps in"
        " one precision, or delete that line"
      )
  return scale


def _shown(text: str, place: int) -> str:
  """A line by its number, and how it begins."""
  line = text[place : place + _SHOWN].partition("\n")[0].strip()
  return f"line {text.count(chr(10), 0, place) + 1} ('{line}')"
