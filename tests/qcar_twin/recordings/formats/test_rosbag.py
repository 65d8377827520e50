"""ROS bags of both generations, written with rosbags itself: topics become columns on one clock."""

import sqlite3

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.definitions import OF_CARS
from qcar_twin.recordings.recording import RecordingError
from tests.qcar_twin.recordings.drives import drive, write_manifest

BEGIN = 1_725_000_000_000_000_000  # ns
TIME, COLUMNS = drive(2.0)
CHANNELS = """
motor_voltage = { column = "/motor.data" }
steering_command = { column = "/cmd.angular.z" }
motor_speed = { column = "/joints.velocity[0]" }
accel_x = { column = "/imu.linear_acceleration.x" }
accel_y = { column = "/imu.linear_acceleration.y" }
yaw_rate = { column = "/imu.angular_velocity.z" }
pose_x = { column = "/pose.pose.position.x" }
pose_yaw = { column = "/pose.pose.orientation.yaw", wrap = true }
"""


class Messages:
  """Messages of a drive, of either generation."""

  def __init__(self, store, ros1=False):
    self.store, self.ros1, self.types = get_typestore(store), ros1, get_typestore(store).types

  def make(self, kind, *fields, **named):
    return self.types[kind](*fields, **named)

  def header(self, nanoseconds, offset=0):
    stamp = self.make("builtin_interfaces/msg/Time", *divmod(BEGIN + nanoseconds + offset, 1_000_000_000))
    return self.make("std_msgs/msg/Header", *((0,) if self.ros1 else ()), stamp, "base")

  def vector(self, x=0.0, y=0.0, z=0.0):
    return self.make("geometry_msgs/msg/Vector3", x, y, z)

  def quaternion(self, yaw):
    return self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))

  def at(self, row, stamp_offset=0):
    """(topic, type, message) that the car publishes at a row."""
    now = round(TIME[row] * 1e9)
    value = {name: float(column[row]) for name, column in COLUMNS.items()}
    zeros = np.zeros(9)
    yield "/motor", "std_msgs/msg/Float64", self.make("std_msgs/msg/Float64", value["motor_voltage"])
    yield (
      "/cmd",
      "geometry_msgs/msg/Twist",
      self.make("geometry_msgs/msg/Twist", self.vector(), self.vector(z=value["steering_command"])),
    )
    joints = (["drive"], np.zeros(1), np.array([value["motor_speed"]]), np.zeros(1))
    yield (
      "/joints",
      "sensor_msgs/msg/JointState",
      self.make("sensor_msgs/msg/JointState", self.header(now, stamp_offset), *joints),
    )
    gyro, accel = self.vector(z=value["yaw_rate"]), self.vector(value["accel_x"], value["accel_y"], 9.81)
    imu = (self.quaternion(0.0), zeros, gyro, zeros, accel, zeros)
    yield "/imu", "sensor_msgs/msg/Imu", self.make("sensor_msgs/msg/Imu", self.header(now, stamp_offset), *imu)
    if row % 10 == 0:
      point = self.make("geometry_msgs/msg/Point", value["pose_x"], value["pose_y"], 0.0)
      pose = self.make("geometry_msgs/msg/Pose", point, self.quaternion(value["pose_yaw"]))
      yield (
        "/pose",
        "geometry_msgs/msg/PoseStamped",
        self.make("geometry_msgs/msg/PoseStamped", self.header(now, stamp_offset), pose),
      )


def write_ros2(folder, plugin, messages=None, stamp_offset=0, delay=0, rows=range(TIME.size)):
  messages = messages or Messages(Stores.ROS2_HUMBLE)
  with Writer2(folder, version=8, storage_plugin=plugin) as writer:
    connections = {}
    for row in rows:
      for topic, kind, message in messages.at(row, stamp_offset):
        if topic not in connections:
          connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
        writer.write(
          connections[topic], BEGIN + round(TIME[row] * 1e9) + delay, messages.store.serialize_cdr(message, kind)
        )
  return folder


def write_ros1(path):
  messages = Messages(Stores.ROS1_NOETIC, ros1=True)
  with Writer1(path) as writer:
    connections = {}
    for row in range(TIME.size):
      for topic, kind, message in messages.at(row):
        if topic not in connections:
          connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
        writer.write(connections[topic], BEGIN + round(TIME[row] * 1e9), messages.store.serialize_ros1(message, kind))
  return path


@pytest.fixture(scope="module", params=["mcap folder", "mcap file", "sqlite folder", "ros1 bag"])
def bag(request, tmp_path_factory):
  folder = tmp_path_factory.mktemp("bags")
  if request.param == "ros1 bag":
    return write_ros1(folder / "drive.bag")
  plugin = StoragePlugin.SQLITE3 if "sqlite" in request.param else StoragePlugin.MCAP
  written = write_ros2(folder / "drive", plugin)
  if request.param == "mcap file":
    return next(written.glob("*.mcap")).rename(folder / "drive.mcap")
  return written


def test_every_generation_gives_the_same_recording(bag):
  (run,) = DataSet.load(write_manifest(bag.parent, (bag.name,), channels=CHANNELS)).recordings
  assert run.name == "drive"
  for channel in ("motor_voltage", "steering_command", "motor_speed", "accel_x", "accel_y", "yaw_rate"):
    assert run[channel].time == pytest.approx(TIME, abs=2e-9)
    assert (run[channel].value == COLUMNS[channel]).all()
  assert run["pose_x"].time == pytest.approx(TIME[::10], abs=2e-9)
  assert run["pose_yaw"].value == pytest.approx(COLUMNS["pose_yaw"][::10], abs=1e-9)


def test_columns_are_topic_dot_field_and_long_arrays_are_left_out(bag):
  columns = read_table(bag).columns
  assert {
    "time",
    "/imu.angular_velocity.z",
    "/imu.linear_acceleration_covariance[8]",
    "/pose.pose.orientation.w",
  } <= set(columns)
  assert not any("header" in name or "stamp" in name for name in columns)


def test_header_stamps_count_unless_they_belong_to_another_clock(tmp_path):
  late = write_ros2(tmp_path / "late", StoragePlugin.MCAP, delay=50_000_000, rows=range(20))
  columns = read_table(late).columns
  sampled = columns["time"][~np.isnan(columns["/imu.angular_velocity.z"])]
  received = columns["time"][~np.isnan(columns["/motor.data"])]
  assert received - sampled == pytest.approx(np.full(20, 0.05), abs=1e-8)
  alien = write_ros2(tmp_path / "alien", StoragePlugin.MCAP, stamp_offset=-BEGIN, rows=range(20))
  columns = read_table(alien).columns
  assert columns["time"] == pytest.approx(TIME[:20], abs=1e-8)


def test_messages_out_of_order_are_sorted_but_a_repeated_stamp_is_an_error(tmp_path):
  order = [0, 1, 3, 2, *range(4, 20)]
  swapped = write_ros2(tmp_path / "swapped", StoragePlugin.MCAP, rows=order)
  assert (np.diff(read_table(swapped).columns["time"]) > 0.0).all()
  twice = write_ros2(tmp_path / "twice", StoragePlugin.MCAP, rows=[0, 1, 2, 2, 3])
  with pytest.raises(RecordingError, match=r"twice: '/motor.data' was left out, 1 of its 5 stamps repeat"):
    read_table(twice).number("/motor.data", "motor_voltage")
  assert any("messages of '/motor.data' are left out" in note for note in read_table(twice).notes)


def test_an_absent_topic_lists_the_topics_there_are(tmp_path):
  write_ros2(tmp_path / "drive", StoragePlugin.MCAP, rows=range(20))
  write_manifest(tmp_path, ("drive",), channels=CHANNELS.replace("/motor.data", "/motr.data"))
  with pytest.raises(
    RecordingError,
    match="motor_voltage is mapped to column '/motr.data', which does not exist; did you mean '/motor.data'",
  ):
    DataSet.load(tmp_path)


def test_damaged_and_empty_bags_say_so(tmp_path):
  (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n nonsense")
  with pytest.raises(RecordingError, match=r"a.mcap: is not a readable bag .*mcap recover"):
    read_table(tmp_path / "a.mcap")
  (tmp_path / "b.bag").write_bytes(b"#ROSBAG V2.0\n nonsense")
  with pytest.raises(RecordingError, match=r"b.bag: unpacks to far more than its 22 bytes"):
    read_table(tmp_path / "b.bag")
  (tmp_path / "folder").mkdir()
  with pytest.raises(RecordingError, match=r"folder: is not a readable bag"):
    read_table(tmp_path / "folder")
  whole = next(write_ros2(tmp_path / "cut", StoragePlugin.MCAP).glob("*.mcap"))
  (tmp_path / "cut.mcap").write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
  with pytest.raises(RecordingError, match=r"cut.mcap: is not a readable bag"):
    read_table(tmp_path / "cut.mcap")
  with Writer2(tmp_path / "silent", version=8, storage_plugin=StoragePlugin.MCAP):
    pass
  with pytest.raises(RecordingError, match="silent: the bag holds no messages with numbers"):
    read_table(tmp_path / "silent")


def test_text_topics_are_no_columns(tmp_path):
  messages = Messages(Stores.ROS2_HUMBLE)
  with Writer2(tmp_path / "talk", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
    connection = writer.add_connection("/chat", "std_msgs/msg/String", typestore=messages.store)
    text = messages.make("std_msgs/msg/String", "hello")
    writer.write(connection, BEGIN, messages.store.serialize_cdr(text, "std_msgs/msg/String"))
  with pytest.raises(RecordingError, match="record the topics of commands, encoder and IMU"):
    read_table(tmp_path / "talk")


def test_messages_of_cars_are_read_from_a_bag_without_definitions(tmp_path):
  """As ROS 2 wrote into SQLite up to Humble; what a VESC says lies behind whole numbers, which have other widths."""
  messages = Messages(Stores.ROS2_HUMBLE)
  for name, text in OF_CARS.items():
    messages.store.register(get_types_from_msg(text, name))
  messages.types = messages.store.types
  drive = messages.make("ackermann_msgs/msg/AckermannDrive", 0.25, 0.0, 1.5, 0.0, 0.0)
  fields = messages.store.fielddefs["vesc_msgs/msg/VescState"][1]
  state = {name: 0 if kind[1][0] == "int32" else 0.0 for name, kind in fields}
  state |= {"speed": 4000.0, "displacement": -7, "avg_vq": 2.5}
  said = {
    "/drive": ("ackermann_msgs/msg/AckermannDriveStamped", drive),
    "/core": ("vesc_msgs/msg/VescStateStamped", messages.make("vesc_msgs/msg/VescState", **state)),
  }
  with Writer2(tmp_path / "old", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
    for topic, (kind, inside) in said.items():
      connection = writer.add_connection(topic, kind, typestore=messages.store)
      for k in range(3):
        message = messages.make(kind, messages.header(k), inside)
        writer.write(connection, BEGIN + k, messages.store.serialize_cdr(message, kind))
  with sqlite3.connect(tmp_path / "old" / "old.db3") as file:
    file.execute("DELETE FROM message_definitions")
  row = {name: values[0] for name, values in read_table(tmp_path / "old").columns.items()}
  assert (row["/drive.drive.steering_angle"], row["/drive.drive.speed"]) == (0.25, 1.5)
  assert (row["/core.state.speed"], row["/core.state.displacement"], row["/core.state.avg_vq"]) == (4000.0, -7.0, 2.5)
