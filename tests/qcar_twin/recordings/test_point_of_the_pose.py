"""A pose of a point off the centre of gravity, as a rear axle's: dataset.toml says where it is."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from tests.qcar_twin.recordings.drives import drive, folder_with
from tests.qcar_twin.recordings.loading import refused

AHEAD, LEFT = -0.15, 0.02
PLAIN = ("time", "motor_voltage", "steering_command", "motor_speed")


def mapped(**pose: str) -> str:
  lines = [f'{name} = {{ column = "{name}" }}' for name in PLAIN]
  return "\n".join(lines + [f'{name} = {{ column = "{name}"{more} }}' for name, more in pose.items()])


def off_centre(columns):
  cosine, sine = np.cos(columns["pose_yaw"]), np.sin(columns["pose_yaw"])
  return columns | {
    "pose_x": columns["pose_x"] + cosine * AHEAD - sine * LEFT,
    "pose_y": columns["pose_y"] + sine * AHEAD + cosine * LEFT,
  }


def test_the_centre_is_found_from_where_the_point_is(tmp_path):
  time, columns = drive()
  channels = mapped(pose_x=f", ahead = {AHEAD}", pose_y=f", left = {LEFT}", pose_yaw="")
  (run,) = DataSet.load(folder_with(tmp_path, time, off_centre(columns), channels=channels)).recordings
  for name in ("pose_x", "pose_y"):
    np.testing.assert_allclose(run[name].value, columns[name] - columns[name][0] + run[name].value[0], atol=1e-6)


def test_without_a_heading_there_is_no_ahead(tmp_path):
  time, columns = drive()
  del columns["pose_yaw"]
  folder = folder_with(tmp_path, time, columns, channels=mapped(pose_x=f", ahead = {AHEAD}", pose_y=""))
  refused(folder, "run.csv: ", "pose_x, pose_y and pose_yaw are needed: map all three")


@pytest.mark.parametrize(("channel", "key", "whose"), [("pose_y", "ahead", "pose_x"), ("pose_x", "left", "pose_y")])
def test_each_belongs_to_its_own_channel(tmp_path, channel, key, whose):
  time, columns = drive()
  pose = {"pose_x": "", "pose_y": "", "pose_yaw": ""} | {channel: f", {key} = 0.1"}
  refused(
    folder_with(tmp_path, time, columns, channels=mapped(**pose)),
    f"[channels] {channel} cannot have {key}, which belongs to {whose}",
  )
