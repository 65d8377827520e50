"""Messages of a bag or an MCAP file as numbers with dotted names, whatever they are encoded in."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from qcar_twin.recordings.formats.table import Clocked

HEAVY = ("Image", "CompressedImage", "PointCloud", "PointCloud2", "LaserScan", "OccupancyGrid", "MarkerArray")
_MAX_ARRAY = 36  # elements; longer arrays are scans and pictures, not channels
_MAX_DEPTH = 8  # of messages in messages; what lies deeper is no channel
_STAMP_TRUST = 10.0  # s; a header stamp further from the receive time belongs to another clock
_STAMPS = ("stamp", "timestamp")
_NS = 1_000_000_000

Row = tuple[int, int, dict[str, float]]  # received and stamped, ns since the bag began, and the numbers by name


def row_of(message: Any, topic: str, received: int, start: int) -> Row | None:
  """What one message says, None where it holds no number."""
  numbers, stamp = dict(_numbers(message, topic, 0)), _stamp(message)
  return (received - start, (received if stamp is None else stamp) - start, numbers) if numbers else None


def topic_columns(rows: list[Row]) -> Clocked:
  """The messages of one topic in order of their stamps; of the receive times where stamps belong to another clock."""
  received = np.array([row[0] for row in rows]) * 1e-9
  stamped = np.array([row[1] for row in rows]) * 1e-9
  time = stamped if np.median(np.abs(stamped - received)) < _STAMP_TRUST else received
  order = np.argsort(time, kind="stable")
  names = dict.fromkeys(name for row in rows for name in row[2])
  columns = {name: np.array([row[2].get(name, math.nan) for row in rows])[order] for name in names}
  return Clocked(time[order], columns)


def _fields(value: Any) -> dict[str, Any] | None:
  """The parts of a message: of ROS (a dataclass), of JSON (an object), of protobuf; None for anything else."""
  if isinstance(value, Mapping):
    return {str(key): part for key, part in value.items()}
  if hasattr(value, "__dataclass_fields__"):
    return {name: getattr(value, name) for name in value.__dataclass_fields__ if name != "__msgtype__"}
  if hasattr(value, "DESCRIPTOR") and hasattr(value, "ListFields"):
    fields = {field.name: getattr(value, field.name) for field in value.DESCRIPTOR.fields}
    return {name: list(part) if _is_repeated(part) else part for name, part in fields.items()}
  return None


def _is_repeated(part: Any) -> bool:
  return hasattr(part, "__len__") and not isinstance(part, str | bytes | Mapping)


def _stamp(message: Any) -> int | None:
  """The header's stamp (Foxglove: the message's own) in ns; None when there is none."""
  parts = _fields(message) or {}
  for holder in (_fields(parts.get("header")) or {}, parts):
    for name in _STAMPS:
      stamp = _fields(holder.get(name)) or {}
      seconds = stamp.get("sec", stamp.get("seconds"))
      rest = stamp.get("nanosec", stamp.get("nsec", stamp.get("nanos", 0)))
      if isinstance(seconds, int) and isinstance(rest, int):
        return seconds * _NS + rest
  return None


def _numbers(value: Any, name: str, depth: int) -> Iterator[tuple[str, float]]:
  """Every number in a message with its dotted name; a quaternion's heading as `….yaw`.

  Where a message names the elements of its lists, as JointState does, they go by that name, too: `velocity[drive]`.
  """
  if isinstance(value, bool | int | float | np.number):
    yield name, float(value)
  elif isinstance(value, np.ndarray | list | tuple):
    for index, element in enumerate(value if len(value) <= _MAX_ARRAY and depth < _MAX_DEPTH else ()):
      yield from _numbers(element, f"{name}[{index}]", depth + 1)
  elif (parts := _fields(value)) is not None and depth < _MAX_DEPTH:
    inside = {key: part for key, part in parts.items() if key not in ("header", *_STAMPS)}
    for key, part in inside.items():
      yield from _numbers(part, f"{name}.{key}", depth + 1)
    yield from _named(inside, name)
    if {"x", "y", "z", "w"} == set(inside) and all(isinstance(part, int | float) for part in inside.values()):
      x, y, z, w = (float(inside[key]) for key in "xyzw")
      yield f"{name}.yaw", math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2))


def _named(parts: dict[str, Any], name: str) -> Iterator[tuple[str, float]]:
  """Elements of lists by the names that the message itself gives them."""
  lists = {key: part for key, part in parts.items() if isinstance(part, np.ndarray | list) and len(part)}
  labels = next((part for part in lists.values() if all(isinstance(label, str) and label for label in part)), [])
  if len(labels) == 0 or len(set(labels)) < len(labels) or len(labels) > _MAX_ARRAY:
    return
  for key, part in lists.items():
    if part is not labels and len(part) == len(labels):
      for label, element in zip(labels, part, strict=True):
        if isinstance(element, bool | int | float | np.number):
          yield f"{name}.{key}[{label}]", float(element)
