"""Cars in several processes: the same as in one, and what is said when a process ends."""

import numpy as np
import pytest

from qcar_twin.envs.fleet_workers import WorkersVecEnv
from qcar_twin.envs.vector_env import FleetVecEnv
from tests.qcar_twin.envs.fleet_rig import make_fleet


def cars(seeds):
  return FleetVecEnv(make_fleet(seeds, "bicycle", sensed=False, path="o", gain_spread=0.1))


def first():
  return cars([4, 5, 6])


def second():
  return cars([7])


def test_two_processes_drive_as_one_and_a_lost_one_is_said():
  whole, parts = cars([4, 5, 6, 7]), WorkersVecEnv([first, second], [3, 1])
  assert parts.observation_space == whole.observation_space and parts.num_envs == 4
  for env in (whole, parts):
    env.seed(11)
  np.testing.assert_array_equal(whole.reset(), parts.reset())
  ended = 0
  for k in range(160):
    action = np.full((4, 1), 1.5 * np.cos(0.01 * k))
    (a, b, c, d), (e, f, g, h) = whole.step(action), parts.step(action)
    for one, other in ((a, e), (b, f), (c, g)):
      np.testing.assert_array_equal(one, other)
    for i in np.flatnonzero(c):
      ended += 1
      np.testing.assert_array_equal(d[i].pop("terminal_observation"), h[i].pop("terminal_observation"))
      assert d[i] == h[i]
    assert all(not h[i] for i in np.flatnonzero(~c))
  assert ended
  parts._processes[0].kill()
  parts._processes[0].join()
  with pytest.raises(RuntimeError, match="a process that drives cars has ended"):
    for _ in range(3):
      parts.step(action)
  parts.close()
  parts.close()
