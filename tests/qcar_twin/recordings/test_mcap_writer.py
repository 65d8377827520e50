"""What is written as MCAP comes back bit for bit through the mcap library's own reader, and loads as a recording."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.mcap_writer import write_mcap
from qcar_twin.recordings.recording import RecordingError, Stream
from tests.qcar_twin.recordings.drives import recording, write_manifest

RUN = recording(seconds=3.0)


def decoded(path):
  """Messages by topic, (log time in ns, message), read by the mcap library and decoded by its ROS 2 support."""
  messages = {}
  with path.open("rb") as file:
    for _, channel, message, content in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
      messages.setdefault(channel.topic, []).append((message.log_time, content))
  return messages


def metadata(path):
  with path.open("rb") as file:
    return {entry.name: entry.metadata for entry in make_reader(file).iter_metadata()}


@pytest.mark.parametrize("start", [0.0, 12.345678, 1_725_000_000.0, -2.5])
def test_every_value_comes_back_bit_for_bit_and_its_time_to_the_nanosecond(tmp_path, start):
  streams = {name: Stream(stream.time + start, stream.value) for name, stream in RUN.streams.items()}
  path = write_mcap(tmp_path / "run.mcap", {"measured": streams}, {"recording": "run"})
  topics, about = decoded(path), metadata(path)["qcar_twin"]
  assert about["recording"] == "run"
  for name, stream in streams.items():
    time, message = zip(*topics[f"/measured/{name}"], strict=True)
    assert [each.data for each in message] == stream.value.tolist()
    back = np.array(time) * 1e-9 + float(about["origin_s"])
    assert np.abs(back - stream.time).max() <= 0.5e-9 + np.spacing(np.abs(stream.time).max())


def test_the_messages_that_viewers_know_say_the_same(tmp_path):
  extra = {"speed": Stream(RUN["motor_speed"].time, 0.003 * RUN["motor_speed"].value)}
  extra |= {"speed_command": Stream(np.array([0.0]), np.array([1.5]))}
  extra |= {"battery_voltage": Stream(np.array([0.0, 1.0]), np.array([12.25, 12.0]))}
  topics = decoded(write_mcap(tmp_path / "run.mcap", {"measured": dict(RUN.streams) | extra}, {}))
  imu = [message for _, message in topics["/measured/imu"]]
  assert [m.angular_velocity.z for m in imu] == RUN["yaw_rate"].value.tolist()
  assert [m.linear_acceleration.y for m in imu] == RUN["accel_y"].value.tolist()
  assert {m.orientation_covariance[0] for m in imu} == {-1.0}  # no orientation was measured
  at, pose = topics["/measured/pose"][7]
  assert pose.header.frame_id == "map" and pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec == at
  assert (pose.pose.position.x, pose.pose.position.y) == (RUN["pose_x"].value[7], RUN["pose_y"].value[7])
  turned = 2.0 * np.arctan2(pose.pose.orientation.z, pose.pose.orientation.w)
  assert turned == pytest.approx(RUN["pose_yaw"].value[7], abs=1e-12)
  assert [m.twist.linear.x for _, m in topics["/measured/twist"]] == extra["speed"].value.tolist()
  assert [list(m.velocity) for _, m in topics["/measured/motor"]] == [[v] for v in RUN["motor_speed"].value]
  drive = [message.drive for _, message in topics["/measured/drive"]]
  assert drive[0].speed == 1.5 and np.isnan(drive[1].speed)
  assert [m.steering_angle for m in drive] == pytest.approx(RUN["steering_command"].value, abs=1e-7)  # float32
  assert [m.voltage for _, m in topics["/measured/battery"]] == [12.25, 12.0]


def test_a_recording_comes_back_through_the_map_of_its_name(tmp_path):
  write_mcap(tmp_path / "run.mcap", {"measured": dict(RUN.streams), "after": {"yaw_rate": RUN["yaw_rate"]}}, {})
  (again,) = DataSet.load(write_manifest(tmp_path, ("run.mcap",), top='name = "lab"\nmap = "qcar_twin"')).recordings
  assert again.channels == RUN.channels
  for name in RUN.channels:
    assert (again[name].value == RUN[name].value).all() and again[name].time == pytest.approx(RUN[name].time, abs=1e-9)


def test_channels_of_their_own_rate_units_and_errors(tmp_path):
  slow = {name: Stream(RUN[name].time[::10], RUN[name].value[::10]) for name in ("pose_x", "pose_y", "pose_yaw")}
  error = {"yaw_rate": RUN["yaw_rate"], "force_x": RUN["accel_x"]}
  sources = {"measured": {"accel_x": RUN["accel_x"], **slow}, "error_after": error}
  path = write_mcap(tmp_path / "run.mcap", sources, {}, {"force_x": "N"})
  topics = decoded(path)
  assert len(topics["/measured/pose"]) == len(slow["pose_x"]) and len(topics["/measured/imu"]) == len(RUN["accel_x"])
  assert np.isnan(topics["/measured/imu"][0][1].angular_velocity.z)  # no gyro
  assert {name for name in topics if name.startswith("/error")} == {"/error_after/yaw_rate", "/error_after/force_x"}
  with path.open("rb") as file:
    units = {c.topic: c.metadata.get("unit") for c in make_reader(file).get_summary().channels.values()}
  assert units["/error_after/force_x"] == "N" and units["/measured/accel_x"] == "m/s^2"


def test_messages_lie_in_order_of_time_and_the_file_is_whole_or_absent(tmp_path):
  path = write_mcap(tmp_path / "run.mcap", {"measured": dict(RUN.streams)}, {})
  with path.open("rb") as file:
    times = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
  assert times == sorted(times)
  with pytest.raises(RecordingError, match="none.mcap: nothing to write"):
    write_mcap(tmp_path / "none.mcap", {"measured": {}}, {})
  with pytest.raises(RecordingError, match="late.mcap: time goes beyond 2147483647 s"):
    write_mcap(tmp_path / "late.mcap", {"measured": {"speed": Stream(np.array([3e9]), np.array([1.0]))}}, {})
  assert [p.name for p in tmp_path.iterdir()] == ["run.mcap"]
