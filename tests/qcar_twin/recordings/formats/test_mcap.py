"""MCAP files of every encoding that is read, written with the mcap library: topics become columns on one clock."""

import json

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError
from tests.qcar_twin.recordings.drives import drive, write_manifest
from tests.qcar_twin.recordings.formats.test_rosbag import BEGIN, Messages

TIME, COLUMNS = drive(2.0)
TICKS = BEGIN + np.round(TIME * 1e9).astype(np.int64)


class File:
  """An MCAP file in the making."""

  def __init__(self, path):
    self.path, self.stream = path, path.open("wb")
    self.writer = Writer(self.stream)
    self.writer.start()

  def topic(self, name, encoding, schema="", schema_encoding="", data=b""):
    number = self.writer.register_schema(schema, schema_encoding, data) if schema_encoding else 0
    return self.writer.register_channel(name, encoding, number)

  def write(self, channel, at, data):
    self.writer.add_message(channel, int(at), data, int(at))

  def done(self):
    self.writer.finish()
    self.stream.close()
    return self.path


def values(row):
  return {name: float(column[row]) for name, column in COLUMNS.items()}


def write_json(path, stamped=True):
  """Foxglove's way: JSON with a schema, a stamp in the message, poses with quaternions."""
  file = File(path)
  car = file.topic("/car", "json", "Car", "jsonschema", b'{"type": "object"}')
  pose = file.topic("/pose", "json")
  for row, at in enumerate(TICKS):
    value = values(row)
    stamp = {"timestamp": {"sec": int(at) // 10**9, "nsec": int(at) % 10**9}} if stamped else {}
    angle = 0.5 * value["pose_yaw"]
    turned = {"x": 0.0, "y": 0.0, "z": np.sin(angle), "w": np.cos(angle)}
    place = {"position": {"x": value["pose_x"], "y": value["pose_y"], "z": 0.0}, "orientation": turned}
    file.write(car, at + 5_000_000, json.dumps({"name": "car 1", "drive": value, **stamp}).encode())
    if row % 10 == 0:
      file.write(pose, at + 5_000_000, json.dumps({"frame_id": "map", "pose": place, **stamp}).encode())
  return file.done()


def protobuf_type():
  """A message type as a logger would bring it along: a descriptor, and the class made of it."""
  file = descriptor_pb2.FileDescriptorProto(name="car.proto", package="car", syntax="proto3")
  stamp = file.message_type.add(name="Stamp")
  for number, name in enumerate(("seconds", "nanos"), 1):
    stamp.field.add(name=name, number=number, type="TYPE_INT64", label="LABEL_OPTIONAL")
  state = file.message_type.add(name="State")
  for number, name in enumerate(COLUMNS, 1):
    state.field.add(name=name, number=number, type="TYPE_DOUBLE", label="LABEL_OPTIONAL")
  state.field.add(name="wheels", number=30, type="TYPE_DOUBLE", label="LABEL_REPEATED")
  state.field.add(name="stamp", number=31, type="TYPE_MESSAGE", type_name=".car.Stamp", label="LABEL_OPTIONAL")
  pool = descriptor_pool.DescriptorPool()
  pool.Add(file)
  made = message_factory.GetMessageClass(pool.FindMessageTypeByName("car.State"))
  return made, descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


def write_protobuf(path):
  made, descriptor = protobuf_type()
  file = File(path)
  car = file.topic("/car", "protobuf", "car.State", "protobuf", descriptor)
  for row, at in enumerate(TICKS):
    message = made(**values(row), wheels=[1.0, 2.0], stamp={"seconds": int(at) // 10**9, "nanos": int(at) % 10**9})
    file.write(car, at + 5_000_000, message.SerializeToString())
  return file.done()


def write_ros1(path):
  """ROS 1 messages inside MCAP, as `mcap convert` makes of a bag."""
  messages, store, file = Messages(Stores.ROS1_NOETIC, ros1=True), get_typestore(Stores.ROS1_NOETIC), File(path)
  channels = {}
  for row, at in enumerate(TICKS):
    for topic, kind, message in messages.at(row):
      if topic not in channels:
        text = store.generate_msgdef(kind)[0].encode()
        channels[topic] = file.topic(topic, "ros1", kind.replace("/msg/", "/"), "ros1msg", text)
      file.write(channels[topic], at, bytes(store.serialize_ros1(message, kind)))
  return file.done()


@pytest.mark.parametrize("stamped", [True, False])
def test_json_topics_are_columns_by_their_stamps_or_else_by_receipt(tmp_path, stamped):
  columns = read_table(write_json(tmp_path / "drive.mcap", stamped)).columns
  assert np.diff(columns["time"]) == pytest.approx(np.diff(TIME), abs=2e-9)
  assert columns["time"][0] == pytest.approx(-0.005 if stamped else 0.0, abs=1e-9)
  for name, column in COLUMNS.items():
    assert (columns[f"/car.drive.{name}"] == column).all()
  there = ~np.isnan(columns["/pose.pose.orientation.yaw"])
  assert columns["/pose.pose.orientation.yaw"][there] == pytest.approx(COLUMNS["pose_yaw"][::10], abs=1e-9)
  assert not any("timestamp" in name or "name" in name or "frame_id" in name for name in columns)


def test_protobuf_topics_are_columns(tmp_path):
  columns = read_table(write_protobuf(tmp_path / "drive.mcap")).columns
  for name, column in COLUMNS.items():
    assert (columns[f"/car.{name}"] == column).all()
  assert set(columns["/car.wheels[1]"]) == {2.0} and not any("stamp" in name for name in columns)


def test_ros_1_inside_mcap_is_the_same_recording(tmp_path):
  write_ros1(tmp_path / "drive.mcap")
  channels = """
motor_voltage = { column = "/motor.data" }
motor_speed = { column = "/joints.velocity[drive]" }
yaw_rate = { column = "/imu.angular_velocity.z" }
"""
  (run,) = DataSet.load(write_manifest(tmp_path, ("drive.mcap",), channels=channels)).recordings
  for name in ("motor_voltage", "motor_speed", "yaw_rate"):
    assert (run[name].value == COLUMNS[name]).all() and run[name].time == pytest.approx(TIME, abs=2e-9)


def test_what_cannot_be_decoded_is_left_out_with_a_warning(tmp_path, caplog):
  file = File(tmp_path / "mixed.mcap")
  good, odd, broken = file.topic("/car", "json"), file.topic("/odd", "cbor"), file.topic("/broken", "json")
  for row, at in enumerate(TICKS[:20]):
    file.write(good, at, json.dumps(values(row)).encode())
    file.write(odd, at, b"\xa1")
    file.write(broken, at, b"{not json")
  columns = read_table(file.done()).columns
  assert {name.split(".")[0] for name in columns} == {"time", "/car"}
  assert (
    "topic /odd is skipped (encoding 'cbor' is not read" in caplog.text and "topic /broken is skipped" in caplog.text
  )
  assert caplog.text.count("/broken") == 1


def test_deep_and_long_messages_are_no_channels(tmp_path):
  deep: object = 1.0
  for _ in range(50):
    deep = {"a": deep}
  file = File(tmp_path / "odd.mcap")
  topic = file.topic("/car", "json")
  for at in TICKS[:20]:
    file.write(topic, at, json.dumps({"v": 1.0, "deep": deep, "scan": list(range(500))}).encode())
  assert list(read_table(file.done()).columns) == ["time", "/car.v"]


def test_damage_is_named(tmp_path):
  whole = write_json(tmp_path / "whole.mcap").read_bytes()
  (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
  with pytest.raises(RecordingError, match=r"cut.mcap: is not a readable bag .*mcap recover"):
    read_table(tmp_path / "cut.mcap")
  empty = File(tmp_path / "empty.mcap")
  empty.topic("/car", "json")
  with pytest.raises(RecordingError, match="empty.mcap: the bag holds no messages with numbers"):
    read_table(empty.done())
