"""Tables of ROS 2 messages without heads, as `ros2 topic echo --csv` writes them: a row a message, a column a field.

The fields come in the order of the message's definition, the header's stamp and frame first, each element of an array
in a column of its own. Definitions are those that rosbags has of ROS 2.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow

from qcar_twin.extras import MissingExtra, extra
from qcar_twin.recordings.formats.definitions import ACKERMANN
from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.unit_names import words_of

# message of a car's log, of one length and with a stamp -> words of a topic that tell it from others of its columns
_MESSAGES = {
  "ackermann_msgs/msg/AckermannDriveStamped": {"drive", "ackermann", "cmd", "command", "control", "teleop"},
  "geometry_msgs/msg/PointStamped": {"point", "position"},
  "geometry_msgs/msg/PoseStamped": {"pose"},
  "geometry_msgs/msg/PoseWithCovarianceStamped": {"pose", "amcl"},
  "geometry_msgs/msg/TwistStamped": {"twist", "vel", "velocity", "cmd"},
  "geometry_msgs/msg/TwistWithCovarianceStamped": {"twist", "vel", "velocity"},
  "geometry_msgs/msg/Vector3Stamped": {"vector", "velocity", "vel", "command", "cmd"},
  "nav_msgs/msg/Odometry": {"odom", "odometry"},
  "sensor_msgs/msg/Imu": {"imu"},
  "sensor_msgs/msg/MagneticField": {"mag", "magnetic"},
  "sensor_msgs/msg/NavSatFix": {"fix", "gps", "gnss"},
  "sensor_msgs/msg/Range": {"range", "sonar", "ultrasound", "tof"},
}
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_NS = 1e9
_BACK = 0.01  # share of rows that are behind the one before them, as of several publishers

Field = tuple[str, str]  # its name with dots, and its type: text, int, float or bool


def with_fields(table: Table, kinds: Sequence[pyarrow.DataType], path: Path) -> Table:
  """A table without a head by the fields of the one message that its columns fit, by their number and types; of several
  such messages by the one that the file is called after. The table as it is where none fits, or no stamp.

  Args:
    kinds: the columns' types as they were read.
  """
  if len(kinds) <= len(_STAMP) + 1 or not all(map(pyarrow.types.is_integer, kinds[:2])) or not _stamped(table):
    return table
  fits = [message for message in _layouts() if _fits(message[1], kinds)]
  if len(fits) > 1:
    words = set(words_of(path.stem))
    fits = [message for message in fits if words & _MESSAGES[message[0]]]
  if len(fits) != 1:
    return table
  names = [name for name, _ in fits[0][1]]
  named = table.named(names)
  return dataclasses.replace(named, told=tuple(names))


def _stamped(table: Table) -> bool:
  """Whether the first two columns are a stamp: nanoseconds within their second, rising but for a few rows."""
  seconds, rest = list(table.columns.values())[:2]
  steps = np.diff(seconds) + np.diff(rest) / _NS
  within = bool(((seconds >= 0.0) & (rest >= 0.0) & (rest < _NS)).all())  # a blank is none
  return within and bool((steps > 0.0).any()) and float(np.mean(steps < 0.0)) <= _BACK


def _fits(fields: Sequence[Field], kinds: Sequence[pyarrow.DataType]) -> bool:
  return len(fields) == len(kinds) and all(_holds(field, kind) for (_, field), kind in zip(fields, kinds, strict=True))


def _holds(field: str, kind: pyarrow.DataType) -> bool:
  """Whether a column of this type may hold a field: a text that is empty in every message is blank."""
  if field == "text":
    return pyarrow.types.is_string(kind) or pyarrow.types.is_null(kind)
  if field == "float" and pyarrow.types.is_floating(kind):
    return True
  return pyarrow.types.is_boolean(kind) if field == "bool" else pyarrow.types.is_integer(kind)


@functools.cache
def _layouts() -> tuple[tuple[str, tuple[Field, ...]], ...]:
  """Each message and its fields, once for every way in which ROS 2 defined it; none where rosbags is not installed."""
  try:
    with extra("Tables of ROS 2 messages without heads"):
      from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415  only such tables need it
  except MissingExtra:
    return ()
  layouts = {}
  for version in (Stores.ROS2_HUMBLE, Stores.LATEST):
    store = get_typestore(version)
    for name, text in ACKERMANN.items():
      store.register(get_types_from_msg(text, name))
    layouts |= {(name, tuple(_fields(store.fielddefs, name, ""))): None for name in _MESSAGES}
  return tuple(layouts)


def _fields(definitions: Any, message: str, stem: str) -> Iterator[Field]:
  """The fields of a message whose arrays have a length of their own."""
  for name, (kind, what) in definitions[message][1]:
    yield from _columns(definitions, kind.name, what, f"{stem}.{name}" if stem else name)


def _columns(definitions: Any, kind: str, what: Any, name: str) -> Iterator[Field]:
  if kind == "NAME":
    yield from _fields(definitions, what, name)
  elif kind == "ARRAY":
    (inner, element), count = what
    for place in range(count):
      yield from _columns(definitions, inner.name, element, f"{name}[{place}]")
  elif kind == "BASE":
    base = what[0]
    yield name, "text" if base == "string" else base if base == "bool" else "float" if "float" in base else "int"
  else:
    raise ValueError(f"{name} has no length of its own")
