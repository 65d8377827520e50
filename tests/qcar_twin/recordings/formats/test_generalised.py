"""A car of a MuJoCo model by its generalised coordinates."""

import numpy as np

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
