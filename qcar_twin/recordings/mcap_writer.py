"""Streams as an MCAP file of ROS 2 messages, which Foxglove, PlotJuggler and Rerun open without configuration.

Every channel is a topic `/source/channel` of `std_msgs/msg/Float64`, its values bit for bit, its times to the
nanosecond of MCAP's clock. Next to them are the messages that viewers know: `/source/imu` (sensor_msgs/Imu),
`/source/pose` (geometry_msgs/PoseStamped, frame "map"), `/source/twist` (geometry_msgs/TwistStamped), `/source/drive`
(ackermann_msgs/AckermannDriveStamped), `/source/motor` (sensor_msgs/JointState), `/source/battery`
(sensor_msgs/BatteryState), NaN where a channel has no sample at that time; of errors, `/error_…`, the channels alone.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qcar_twin.atomic_io import whole_file
from qcar_twin.extras import extra
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.formats.definitions import ACKERMANN
from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.recording import RecordingError, Stream

with extra("Writing MCAP files"):
  from mcap.writer import Writer
  from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_FLOAT = "std_msgs/msg/Float64"
_FRAME, _BODY = "map", "base_link"
_NS = 1_000_000_000
_ERRORS = "error_"  # sources that begin so hold differences, which are no motion of a car
_LATEST = 2**31 - 1  # s, that a header's stamp can hold

Sources = Mapping[str, Mapping[str, Stream]]


class _Messages:
  """ROS 2 types, their definitions, and messages of them."""

  def __init__(self) -> None:
    self.store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in ACKERMANN.items():
      self.store.register(get_types_from_msg(text, name))

  def make(self, kind: str, *fields: Any) -> Any:
    return self.store.types[kind](*fields)  # pyright: ignore[reportCallIssue]

  def definition(self, kind: str) -> bytes:
    return self.store.generate_msgdef(kind, ros_version=2)[0].encode("utf-8")

  def encode(self, message: Any) -> bytes:
    return bytes(self.store.serialize_cdr(message, message.__msgtype__, little_endian=True))

  def header(self, nanoseconds: int, frame: str = _BODY) -> Any:
    stamp = self.make("builtin_interfaces/msg/Time", *divmod(nanoseconds, _NS))
    return self.make("std_msgs/msg/Header", stamp, frame)

  def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return self.make("geometry_msgs/msg/Vector3", x, y, z)

  def turned(self, yaw: float) -> Any:
    return self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))


def _imu(m: _Messages, at: int, value: Mapping[str, float]) -> Any:
  """Without an orientation, which Imu says by a first covariance of -1."""
  none, unknown = np.zeros(9), np.r_[-1.0, np.zeros(8)]
  turn, force = m.vector(z=value["yaw_rate"]), m.vector(value["accel_x"], value["accel_y"])
  return m.make("sensor_msgs/msg/Imu", m.header(at), m.turned(0.0), unknown, turn, none, force, none)


def _pose(m: _Messages, at: int, value: Mapping[str, float]) -> Any:
  point = m.make("geometry_msgs/msg/Point", value["pose_x"], value["pose_y"], 0.0)
  pose = m.make("geometry_msgs/msg/Pose", point, m.turned(value["pose_yaw"]))
  return m.make("geometry_msgs/msg/PoseStamped", m.header(at, _FRAME), pose)


def _twist(m: _Messages, at: int, value: Mapping[str, float]) -> Any:
  twist = m.make("geometry_msgs/msg/Twist", m.vector(value["speed"]), m.vector())
  return m.make("geometry_msgs/msg/TwistStamped", m.header(at), twist)


def _drive(m: _Messages, at: int, value: Mapping[str, float]) -> Any:
  drive = (value["steering_command"], 0.0, value["speed_command"], 0.0, 0.0)
  return m.make(
    "ackermann_msgs/msg/AckermannDriveStamped", m.header(at), m.make("ackermann_msgs/msg/AckermannDrive", *drive)
  )


def _motor(m: _Messages, at: int, value: Mapping[str, float]) -> Any:
  none = np.zeros(0)
  return m.make("sensor_msgs/msg/JointState", m.header(at), ["motor"], none, np.array([value["motor_speed"]]), none)


def _battery(m: _Messages, at: int, value: Mapping[str, float]) -> Any:
  """What was not measured is NaN, as BatteryState asks for; status, health and technology are unknown: 0."""
  unknown, none = math.nan, np.zeros(0, dtype=np.float32)
  measured = (value["battery_voltage"], unknown, value["armature_current"], *[unknown] * 4)
  return m.make("sensor_msgs/msg/BatteryState", m.header(at), *measured, 0, 0, 0, True, none, none, "", "")


@dataclass(frozen=True)
class _View:
  """A message that viewers know, written where one of its channels has a sample, or, if `whole`, where all have."""

  topic: str
  kind: str
  channels: tuple[str, ...]
  whole: bool
  build: Callable[[_Messages, int, Mapping[str, float]], Any]


_VIEWS = (
  _View("imu", "sensor_msgs/msg/Imu", ("yaw_rate", "accel_x", "accel_y"), False, _imu),
  _View("pose", "geometry_msgs/msg/PoseStamped", ("pose_x", "pose_y", "pose_yaw"), True, _pose),
  _View("twist", "geometry_msgs/msg/TwistStamped", ("speed",), True, _twist),
  _View("drive", "ackermann_msgs/msg/AckermannDriveStamped", ("steering_command", "speed_command"), False, _drive),
  _View("motor", "sensor_msgs/msg/JointState", ("motor_speed",), True, _motor),
  _View("battery", "sensor_msgs/msg/BatteryState", ("battery_voltage", "armature_current"), False, _battery),
)


def streams_of_table(table: Table) -> dict[str, Stream]:
  """The numeric columns of any log next to its column `time`, s, by name; blank cells are no samples."""
  time = table.number("time", "time")
  numbers = {name: column for name, column in table.columns.items() if name != "time" and column.dtype != object}
  there = {name: np.isfinite(column) for name, column in numbers.items()}
  return {name.strip("/"): Stream(time[there[name]], column[there[name]]) for name, column in numbers.items()}


def write_mcap(
  path: str | os.PathLike[str], sources: Sources, about: Mapping[str, str], units: Mapping[str, str] | None = None
) -> Path:
  """Write streams; returns the path. The file appears whole or not at all.

  Args:
    path: of the file.
    sources: who says it ("measured", "before", …) -> channel -> stream.
    about: kept in the file as metadata "qcar_twin", with `origin_s`: what to add to MCAP's time to get the streams'.
    units: of channels that are none of CHANNELS.

  Raises:
    RecordingError: nothing to write, or times that MCAP cannot hold.
  """
  streams = [stream for channels in sources.values() for stream in channels.values() if len(stream)]
  if not streams:
    raise RecordingError(f"{Path(path).name}: nothing to write, no channel has a sample")
  first = min(float(stream.time[0]) for stream in streams)
  origin = math.floor(first) if first < 0.0 else 0.0
  if max(float(stream.time[-1]) for stream in streams) - origin > _LATEST:
    raise RecordingError(f"{Path(path).name}: time goes beyond {_LATEST} s, the last stamp of ROS; set time's offset")
  messages, known = _Messages(), {name: channel.unit for name, channel in CHANNELS.items()} | dict(units or {})
  with whole_file(path) as part:
    with part.open("wb") as file:
      writer = Writer(file)
      writer.start(profile="ros2", library="qcar-twin")
      _write(writer, messages, sources, known, origin)
      writer.add_metadata("qcar_twin", {**about, "origin_s": repr(origin)})
      writer.finish()
  return Path(path)


def _write(writer: Writer, messages: _Messages, sources: Sources, units: Mapping[str, str], origin: float) -> None:
  """All messages in order of time, so that a viewer finds those of one moment side by side."""
  schemas: dict[str, int] = {}
  entries: list[tuple[int, int, bytes]] = []

  def topic(name: str, kind: str, unit: str = "") -> int:
    if kind not in schemas:
      schemas[kind] = writer.register_schema(kind, "ros2msg", messages.definition(kind))
    return writer.register_channel(name, "cdr", schemas[kind], {"unit": unit} if unit else {})

  for source, channels in sources.items():
    for channel, stream in channels.items():
      if len(stream):
        number = topic(f"/{source}/{channel}", _FLOAT, units.get(channel, ""))
        values = (messages.encode(messages.make(_FLOAT, value)) for value in stream.value.tolist())
        entries += zip(_ticks(stream.time, origin).tolist(), [number] * len(stream), values, strict=True)
    for view in _VIEWS if not source.startswith(_ERRORS) else ():
      rows = _rows(view, channels, origin)
      if rows:
        number = topic(f"/{source}/{view.topic}", view.kind)
        entries += [(at, number, messages.encode(view.build(messages, at, value))) for at, value in rows]
  entries.sort(key=lambda entry: entry[:2])
  for at, number, data in entries:
    writer.add_message(number, at, data, at)


def _ticks(time: np.ndarray, origin: float) -> np.ndarray:
  """MCAP's time, whole ns since the origin."""
  return np.round((time - origin) * 1e9).astype(np.int64)


def _rows(view: _View, channels: Mapping[str, Stream], origin: float) -> list[tuple[int, dict[str, float]]]:
  """Times at which a view has something to say, and its channels there; NaN where one has no sample."""
  there = {name: channels[name] for name in view.channels if name in channels and len(channels[name])}
  if not there or (view.whole and len(there) < len(view.channels)):
    return []
  values = {
    name: dict(zip(_ticks(s.time, origin).tolist(), s.value.tolist(), strict=True)) for name, s in there.items()
  }
  times = sorted(set.intersection(*map(set, values.values())) if view.whole else set().union(*values.values()))
  return [(at, {name: values.get(name, {}).get(at, math.nan) for name in view.channels}) for at in times]
