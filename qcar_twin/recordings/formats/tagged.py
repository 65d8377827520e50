"""Samples among the lines of a program's log: each begins with a tag, behind which a tool writes columns without names.

AWS DeepRacer's simulator traces a step a line, `SIM_TRACE_LOG:0,1,…`, between lines of other kinds. What the columns
are stands in its developer guide and in the analysis tools of its users (aws-deepracer-community/deepracer-analysis):
the place in m, heading and commanded road-wheel angle in degrees, the commanded speed in m/s, the clock in s.
"""

import re
from pathlib import Path

_TAGS = {
  b"SIM_TRACE_LOG:": (
    "episode", "steps", "x [m]", "y [m]", "yaw [deg]", "steering_angle_command [deg]", "speed_command [m/s]", "action",
    "reward", "done", "all_wheels_on_track", "progress", "closest_waypoint", "track_length", "time [s]", "status",
    "pause_duration",
  ),
}  # fmt: skip
_HEAD = 1 << 20  # bytes, among which a tag stands, where a file has one


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
