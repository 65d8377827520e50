"""MCAP files: messages of ROS 1 and 2, JSON and protobuf, every topic's numbers as columns `topic.field`.

Types come from the file's own schemas. Nothing is looked up elsewhere and no code of the file is run.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from qcar_twin.extras import extra
from qcar_twin.recordings.formats.messages import HEAVY, Row, row_of, topic_columns
from qcar_twin.recordings.formats.rosbag import damaged, read_bag, table_of
from qcar_twin.recordings.formats.table import Clocked, Table
from qcar_twin.recordings.recording import RecordingError

with extra("Reading MCAP files"):
  from mcap.exceptions import McapError
  from mcap.reader import McapReader, make_reader
  from mcap.records import Channel, Schema
  from mcap_protobuf.decoder import DecoderFactory
  from rosbags.typesys import Stores, get_types_from_msg, get_typestore

READERS = {".mcap": "read_mcap"}
_log = logging.getLogger(__name__)
_ROS2 = "cdr"

Decode = Callable[[bytes], Any]


def read_mcap(path: Path, label: str) -> Table:
  """One row per message time, NaN where a topic has no message then; columns as `rosbag.read_bag` names them.

  A file of ROS 2 alone is read as a bag. Topics in an encoding that isn't known are left out with a warning.
  """
  try:
    with path.open("rb") as file:
      reader = make_reader(file)
      summary = reader.get_summary()
      ros2 = summary is not None and {channel.message_encoding for channel in summary.channels.values()} <= {_ROS2}
      topics = [] if ros2 else _read(reader, label)
  except (RecordingError, PermissionError):
    raise
  except Exception as error:  # the reader raises many kinds for damaged files
    raise damaged(label, error) from error
  return read_bag(path, label) if ros2 else table_of(label, topics)


def _read(reader: McapReader, label: str) -> list[Clocked]:
  decoders: dict[int, Decode | None] = {}
  rows: dict[str, list[Row]] = {}
  start: int | None = None
  for schema, channel, message in reader.iter_messages():
    start = message.log_time if start is None else start
    if channel.id not in decoders:
      decoders[channel.id] = _decoder(schema, channel, label)
    decode = decoders[channel.id]
    if decode is None:
      continue
    try:
      row = row_of(decode(bytes(message.data)), channel.topic, message.log_time, start)
    except Exception as error:  # each encoding raises its own
      _skipped(label, channel, str(error))
      decoders[channel.id] = None
      continue
    if row:
      rows.setdefault(channel.topic, []).append(row)
  return [topic_columns(topic) for topic in rows.values()]


def _decoder(schema: Schema | None, channel: Channel, label: str) -> Decode | None:
  """How a channel's messages are read; None for pictures, scans and what nobody here can read."""
  if schema is not None and schema.name.rsplit("/", 1)[-1].rsplit(".", 1)[-1] in HEAVY:
    return None
  try:
    if channel.message_encoding == "json":
      return json.loads
    if channel.message_encoding == "protobuf":
      return DecoderFactory().decoder_for("protobuf", schema)
    if schema is not None and (channel.message_encoding, schema.encoding) in (("ros1", "ros1msg"), (_ROS2, "ros2msg")):
      return _ros_decoder(schema, channel.message_encoding)
  except (McapError, ValueError, TypeError) as error:
    _skipped(label, channel, str(error))
    return None
  _skipped(label, channel, f"encoding '{channel.message_encoding}' is not read; record ROS, JSON or protobuf")
  return None


def _ros_decoder(schema: Schema, encoding: str) -> Decode:
  """By rosbags, with the type that the file's schema defines."""
  types = get_types_from_msg(schema.data.decode("utf-8"), schema.name)
  store = get_typestore(Stores.EMPTY)
  store.register(types)
  name = next(iter(types))  # as rosbags writes it: package/msg/Type
  read = store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr
  return lambda raw: read(raw, name)


def _skipped(label: str, channel: Channel, why: str) -> None:
  _log.warning("%s: topic %s is skipped (%s)", label, channel.topic, why)
