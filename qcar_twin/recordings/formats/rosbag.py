"""ROS 2 MCAP and SQLite bags and ROS 1 bags: every topic's numbers as columns `topic.field`, without ROS."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from qcar_twin.recordings.formats.table import Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError

READERS = {".mcap": "read_bag", ".bag": "read_bag", ".db3": "read_bag"}
_log = logging.getLogger(__name__)
_HEAVY = ("Image", "CompressedImage", "PointCloud", "PointCloud2", "LaserScan", "OccupancyGrid", "MarkerArray")
_MAX_ARRAY = 36  # elements; longer arrays are scans and pictures, not channels
_STAMP_TRUST = 10.0  # s; a header stamp further from the receive time belongs to another clock


def read_bag(path: Path, label: str) -> Table:
  """One row per message time, NaN where a topic has no message then.

  `time` is seconds since the bag began, from `header.stamp` where a topic has one, else when the message was received.
  `/imu.angular_velocity.z`, `/joints.velocity[0]`; a quaternion also gives its heading, `/pose.pose.orientation.yaw`.
  """
  try:
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
      topics = _read_topics(reader, label)
  except (RecordingError, PermissionError, MemoryError):
    raise
  except Exception as error:  # the reader raises many kinds for damaged files
    raise RecordingError(
      f"{label}: is not a readable bag ({error}); a bag that was cut off can be repaired with `mcap recover` or "
      "`ros2 bag reindex`"
    ) from error
  if not topics:
    raise RecordingError(
      f"{label}: the bag holds no messages with numbers; record the topics of commands, encoder and IMU"
    )
  return merge(label, topics)


def _read_topics(reader: AnyReader, label: str) -> list[Clocked]:
  rows: dict[str, list[tuple[int, int, dict[str, float]]]] = {}
  refused: set[str] = set()
  wanted = [connection for connection in reader.connections if connection.msgtype.rsplit("/", 1)[-1] not in _HEAVY]
  if not wanted:
    return []
  start = reader.start_time
  for connection, received, raw in reader.messages(connections=wanted):
    if connection.topic in refused:
      continue
    try:
      message = reader.deserialize(raw, connection.msgtype)
    except (AnyReaderError, KeyError) as error:
      refused.add(connection.topic)
      _log.warning("%s: topic %s of type %s is skipped (%s)", label, connection.topic, connection.msgtype, error)
      continue
    row = dict(_numbers(message, connection.topic))
    if row:
      rows.setdefault(connection.topic, []).append((received - start, _stamp(message) - start, row))
  return [_topic(entries) for entries in rows.values()]


def _topic(entries: list[tuple[int, int, dict[str, float]]]) -> Clocked:
  received = np.array([entry[0] for entry in entries]) * 1e-9
  stamped = np.array([entry[1] for entry in entries]) * 1e-9
  time = stamped if np.median(np.abs(stamped - received)) < _STAMP_TRUST else received
  order = np.argsort(time, kind="stable")
  names = dict.fromkeys(name for entry in entries for name in entry[2])
  columns = {name: np.array([entry[2].get(name, math.nan) for entry in entries])[order] for name in names}
  return Clocked(time[order], columns)


def _stamp(message: Any) -> int:
  """The header's stamp in ns; 0 when there is none."""
  stamp = getattr(getattr(message, "header", None), "stamp", None)
  return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec) if stamp is not None else 0


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
  """Every number in a message with its dotted name."""
  if isinstance(value, bool | int | float | np.number):
    yield name, float(value)
  elif isinstance(value, np.ndarray | list):
    for index, element in enumerate(value if len(value) <= _MAX_ARRAY else ()):
      yield from _numbers(element, f"{name}[{index}]")
  elif hasattr(value, "__dataclass_fields__"):
    fields = [field for field in value.__dataclass_fields__ if field not in ("header", "__msgtype__")]
    for field in fields:
      yield from _numbers(getattr(value, field), f"{name}.{field}")
    if {"x", "y", "z", "w"} == set(fields):
      yield (
        f"{name}.yaw",
        math.atan2(2.0 * (value.w * value.z + value.x * value.y), 1.0 - 2.0 * (value.y**2 + value.z**2)),
      )
