"""A car of a MuJoCo model by its generalised coordinates; vectors of three, along axes or a place and a heading."""

import json

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.columns import Columns, guess_columns
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table


def episode(folder, **changed):
  """A car that turns by the first of three actuators; its qpos begins with a free joint, its steered wheels follow."""
  time = np.arange(2000) / 100.0
  steer, speed = 0.2 * np.sin(1.3 * time), 2.0 + np.sin(0.7 * time)
  rate = speed * np.tan(steer) / 0.33
  yaw = np.cumsum(rate) / 100.0
  vx, vy = speed * np.cos(yaw), speed * np.sin(yaw)
  zero, level = np.zeros(time.size), np.full(time.size, 0.055)
  qpos = [np.cumsum(vx) / 100.0, np.cumsum(vy) / 100.0, level, np.cos(yaw / 2.0), zero, zero, np.sin(yaw / 2.0), steer]
  qvel = [vx, vy, zero, zero, zero, rate, np.gradient(steer, 0.01)]
  drive = 0.3 + 0.1 * np.cos(0.7 * time)
  arrays = {
    "time": time,
    "qpos": np.stack(qpos, 1),
    "qvel": np.stack(qvel, 1),
    "ctrl": np.stack([steer, drive, drive], 1),
  }
  np.savez(folder / "episode.npz", **(arrays | changed))
  return read_table(folder / "episode.npz"), speed, rate


def test_place_heading_speed_and_turning_are_those_of_the_free_joint(tmp_path):
  table, speed, rate = episode(tmp_path)
  np.testing.assert_allclose(table.columns["qvel.speed [m/s]"], speed, rtol=1e-12)
  np.testing.assert_allclose(table.columns["qvel.yaw rate [rad/s]"], rate, rtol=1e-12)
  text = propose("mujoco", [table], wheelbase=0.33, mass=4.2).text
  for line in (
    'steering_command = { column = "ctrl[0]" }',
    'pose_yaw = { column = "qpos.yaw"',
    'column = "qpos.position.x"',
  ):
    assert line in text


def test_coordinates_that_begin_with_no_free_joint_are_left_as_they_are(tmp_path):
  rolled = np.random.default_rng(1).normal(size=(2000, 8))
  table, *_ = episode(tmp_path, qpos=rolled)
  assert not any(name.startswith("qpos.") for name in table.columns)


def round_the_corner(turns):
  """Time, and place and heading, (3, k), of a car that turns by so many turns as it goes on."""
  time = np.arange(200) / 20.0
  yaw = turns * 2.0 * np.pi * (time / time[-1]) ** 2
  place = [np.cumsum(np.cos(yaw)), np.cumsum(np.sin(yaw))]
  return time, np.stack([*place, np.angle(np.exp(1j * yaw))])


@pytest.mark.parametrize("turns", [0.3, 2.0])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_third_of_a_pose_that_goes_with_its_path_or_jumps_by_a_turn_is_a_heading(tmp_path, turns, way):
  time, pose = round_the_corner(turns)
  pose[:2] *= way  # backwards, too
  pose[:, 7] = np.nan
  np.savez(tmp_path / "slam.npz", time=time, pose=pose.T, state=pose.T)
  table = read_table(tmp_path / "slam.npz")
  assert {"pose.x", "pose.y", "pose.yaw", "state.z"} <= set(table.columns)
  np.testing.assert_array_equal(table.columns["pose.yaw"], pose[2])


def test_a_height_stays_one(tmp_path):
  time, pose = round_the_corner(2.0)
  for name, height in (("level", 0.1 + 0.0 * time), ("ramp", 0.3 * time)):
    np.savez(tmp_path / f"{name}.npz", time=time, pose=np.stack([*pose[:2], height], 1))
    assert "pose.z" in read_table(tmp_path / f"{name}.npz")


def test_lists_of_three_in_json_have_axes_and_keep_their_numbers(tmp_path):
  """An IMU's `a` is an acceleration and its `g` a gyro; joints are no axes."""
  time, pose = round_the_corner(2.0)
  rows = [
    {"t": t, "imu": {"a": [0.5 * t, t, 9.8], "g": [0.0, 0.1, np.sin(t)]}, "pose": list(p), "joints": [t, t, t]}
    for t, p in zip(time, pose.T, strict=True)
  ]
  (tmp_path / "run.jsonl").write_text("\n".join(map(json.dumps, rows)), encoding="utf-8")
  table = read_table(tmp_path / "run.jsonl")
  np.testing.assert_array_equal(table.columns["imu.a[1]"], table.columns["imu.a.y"])
  assert "pose.yaw" in table and "joints[2]" in table and "joints.z" not in table
  named = {channel: guess.column for channel, guess in guess_columns(Columns([table])).items()}
  assert (named["accel_x"], named["accel_y"]) == ("imu.a.x", "imu.a.y")
  assert (named["yaw_rate"], named["pose_yaw"]) == ("imu.g.z", "pose.yaw")
