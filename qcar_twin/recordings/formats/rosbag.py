"""ROS 1 bags and ROS 2 bag folders: every topic's numbers as columns `topic.field`, without ROS."""

from __future__ import annotations

import logging
from pathlib import Path

from qcar_twin.extras import extra
from qcar_twin.recordings.formats.definitions import OF_CARS
from qcar_twin.recordings.formats.messages import HEAVY, Row, row_of, topic_columns
from qcar_twin.recordings.formats.table import Clocked, Table, merge_kinds
from qcar_twin.recordings.recording import RecordingError

with extra("Reading ROS bags and MCAP files"):
  from rosbags.highlevel import AnyReader, AnyReaderError
  from rosbags.typesys import Stores, get_types_from_msg, get_typestore
  from rosbags.typesys.store import Typestore

READERS = {".bag": "read_bag", ".db3": "read_bag"}
_log = logging.getLogger(__name__)


def read_bag(path: Path, label: str) -> Table:
  """One row per message time, NaN where a topic has no message then.

  `time` is seconds since the bag began, from `header.stamp` where a topic has one, else when the message was received.
  `/imu.angular_velocity.z`, `/joints.velocity[0]`; a quaternion also gives its heading, `/pose.pose.orientation.yaw`.
  """
  try:
    with AnyReader([path], default_typestore=_known_types()) as reader:
      topics = _read_topics(reader, label)
  except (RecordingError, PermissionError, MemoryError):
    raise
  except Exception as error:  # the reader raises many kinds for damaged files
    raise damaged(label, error) from error
  return table_of(label, topics)


def _known_types() -> Typestore:
  """Types for bags without definitions, as ROS 2 wrote into SQLite before Iron: its own, and those of usual cars."""
  store = get_typestore(Stores.ROS2_HUMBLE)
  for name, text in OF_CARS.items():
    store.register(get_types_from_msg(text, name))
  return store


def damaged(label: str, error: Exception) -> RecordingError:
  """What to tell of a bag that cannot be read."""
  return RecordingError(
    f"{label}: is not a readable bag ({error}); a bag that was cut off can be repaired with `mcap recover` or "
    "`ros2 bag reindex`"
  )


def table_of(label: str, topics: list[Clocked]) -> Table:
  """The topics' columns on one clock. Raises RecordingError when there are none."""
  if not topics:
    raise RecordingError(
      f"{label}: the bag holds no messages with numbers; record the topics of commands, encoder and IMU"
    )
  return merge_kinds(label, topics)


def _read_topics(reader: AnyReader, label: str) -> list[Clocked]:
  rows: dict[str, list[Row]] = {}
  refused: set[str] = set()
  wanted = [connection for connection in reader.connections if connection.msgtype.rsplit("/", 1)[-1] not in HEAVY]
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
    if row := row_of(message, connection.topic, received, start):
      rows.setdefault(connection.topic, []).append(row)
  return [topic_columns(topic) for topic in rows.values()]
