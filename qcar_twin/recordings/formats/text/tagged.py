"""Samples among the lines of a program's log: each begins with a tag, behind which a tool writes columns without names.

ArduPilot's dataflash logs as text describe their own messages: a line `FMT, type, length, IMU, Qfff, TimeUS,GyrX,…` has
the names of the values of lines that begin with `IMU` (its developer wiki, "Onboard Message Log Messages").

AWS DeepRacer's simulator traces a step a line, `SIM_TRACE_LOG:0,1,…`, between lines of other kinds. What the columns
are stands in its developer guide and in the analysis tools of its users (aws-deepracer-community/deepracer-analysis):
the place in m, heading and commanded road-wheel angle in degrees, the commanded speed in m/s, the clock in s.
"""

import re
from pathlib import Path

import numpy as np

from qcar_twin.recordings.formats.table import Clocked, Table, merge_kinds

_TAGS = {
  b"SIM_TRACE_LOG:": (
    "episode", "steps", "x [m]", "y [m]", "yaw [deg]", "steering_angle_command [deg]", "speed_command [m/s]", "action",
    "reward", "done", "all_wheels_on_track", "progress", "closest_waypoint", "track_length", "time [s]", "status",
    "pause_duration",
  ),
}  # fmt: skip
_DATAFLASH = b"FMT, 128"  # the message that describes the others is the first
_HEAD = 1 << 20  # bytes, among which a tag stands, where a file has one


def holds_messages(path: Path) -> bool:
  """Whether a file is a log of either kind."""
  with path.open("rb") as file:
    head = file.read(_HEAD)
  return head.startswith(_DATAFLASH) or any(tag in head for tag in _TAGS)


def tagged_samples(path: Path) -> bytes | None:
  """The samples as CSV with a header, in the columns that every line has; None where a file has no such lines."""
  with path.open("rb") as file:
    head = file.read(_HEAD)
  tag = next((tag for tag in _TAGS if tag in head), None)
  if tag is None:
    return None
  rows = re.findall(re.escape(tag) + rb"([^\r\n\"]*)", path.read_bytes())
  cells = [row.replace(b"\t", b" ").split(b",") for row in rows]
  whole = max((len(row) for row in cells), default=0)  # the last line is often cut off
  names = _TAGS[tag][:whole]
  lines = [b",".join(cell.strip() for cell in row[: len(names)]) for row in cells if len(row) == whole]
  return b"\n".join([",".join(names).encode(), *lines, b""])


_MICROSECONDS, _INSTANCES = "TimeUS", ("I", "Instance")  # the clock, and which of several sensors
_UNITS, _OF_INSTANCE = "FMTU", "#"  # the message that has the units of another's columns, and that of an instance


def messages_of(path: Path, label: str) -> Table | None:
  """A dataflash log's messages, `IMU.GyrX` on the clock of its message in s, `IMU_1.GyrX` of a second sensor; None
  where a file is no such log."""
  with path.open("rb") as file:
    if not file.read(len(_DATAFLASH)) == _DATAFLASH:
      return None
  lines = [[cell.strip() for cell in line.split(",")] for line in path.read_text("utf-8", "replace").splitlines()]
  names = {line[3]: line[5:] for line in lines if line[0] == "FMT" and len(line) > 5}
  types = {line[1]: line[3] for line in lines if line[0] == "FMT" and len(line) > 5}
  units = {types[line[2]]: line[3] for line in lines if line[0] == _UNITS and len(line) > 3 and line[2] in types}
  numbered = {kind: (*_numbered(names[kind], own), *_INSTANCES) for kind, own in units.items()}
  rows: dict[str, list[list[str]]] = {}
  for kind, *cells in lines:
    columns = names.get(kind, [])
    if kind == "FMT" or len(cells) != len(columns) or _MICROSECONDS not in columns:
      continue
    own = next((cells[columns.index(key)] for key in numbered.get(kind, _INSTANCES) if key in columns), "0")
    rows.setdefault(kind if own == "0" else f"{kind}_{own}", []).append(cells)
  groups = [_message(kind, names[kind.partition("_")[0]], cells) for kind, cells in rows.items()]
  return merge_kinds(label, [group for group in groups if group.columns])


def _numbered(names: list[str], units: str) -> list[str]:
  """The columns of a message that say which of several sensors or estimators it is of."""
  return [name for name, unit in zip(names, units, strict=False) if unit == _OF_INSTANCE]


def _message(kind: str, names: list[str], cells: list[list[str]]) -> Clocked:
  columns = {}
  for name, values in zip(names, zip(*cells, strict=True), strict=True):
    try:
      columns[f"{kind}.{name}"] = np.array(values, dtype=float)
    except ValueError:  # a text
      continue
  time = columns.pop(f"{kind}.{_MICROSECONDS}", np.empty(0))
  return Clocked(1e-6 * time, columns)
