"""The gymnasium, stable-baselines3 and dm_control faces of one fleet."""

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasium_check
from stable_baselines3.common.env_checker import check_env as sb3_check

from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.envs.dm_env import OBSERVATIONS, Suite, environment
from qcar_twin.envs.gym_env import FleetVectorEnv, PathTrackingEnv
from qcar_twin.envs.vector_env import FleetVecEnv
from tests.qcar_twin.envs.fleet_rig import VEHICLE, actions, make_fleet

SEED = 11


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_gymnasium_accepts_it():
  gymnasium_check(PathTrackingEnv(make_fleet([0])), skip_render_check=True)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_stable_baselines_accepts_it():
  sb3_check(PathTrackingEnv(make_fleet([0], "bicycle", sensed=False)))


def test_pictures_come_at_the_rate_of_the_plants_clock():
  def slower():
    plant = Bicycle(VEHICLE)
    plant.period = 0.02
    return plant

  slow, usual = (PathTrackingEnv(make_fleet([0], plant, sensed=False)) for plant in (slower, "bicycle"))
  assert (slow.metadata["render_fps"], usual.metadata["render_fps"]) == (50, 100)
  assert slow.metadata["render_modes"] == PathTrackingEnv.metadata["render_modes"]
  assert PathTrackingEnv.metadata["render_fps"] == 100


def test_one_car_only():
  with pytest.raises(ValueError, match="FleetVecEnv"):
    PathTrackingEnv(make_fleet([0, 1], "bicycle", sensed=False))


def gym_run(rates, plant):
  env = PathTrackingEnv(make_fleet([0], plant, lost=0.08))
  first, _ = env.reset(seed=SEED)
  seen, rewards, ends = [first], [], []
  for rate in rates:
    observation, reward, terminated, truncated, _ = env.step(np.array([rate], dtype=np.float32))
    if terminated or truncated:
      observation, _ = env.reset()
    seen.append(observation)
    rewards.append(reward)
    ends.append(terminated)
  return np.stack(seen), np.array(rewards), np.array(ends)


@pytest.mark.parametrize("plant", ["twin", "bicycle"])
def test_same_seed_and_actions_same_trajectory_single_and_vectorised(plant):
  """Car i of a vectorised environment seeded with s is the gymnasium environment seeded with s + i, bit for bit."""
  rates = actions(200, 3).astype(np.float32)
  env = FleetVecEnv(make_fleet([0, 0, 0], plant, lost=0.08))
  env.seed(SEED - 1)
  seen, rewards, ends = [env.reset()], [], []
  for rate in rates:
    observation, reward, done, infos = env.step(rate[:, None])
    seen.append(observation)
    rewards.append(reward)
    ends.append([d and not i["TimeLimit.truncated"] for d, i in zip(done, infos, strict=True)])
  alone = gym_run(rates[:, 1], plant)
  assert alone[2].any(), "the run should contain a restart"
  np.testing.assert_array_equal(np.stack(seen)[:, 1], alone[0])
  np.testing.assert_array_equal(np.stack(rewards)[:, 1], alone[1].astype(np.float32))
  np.testing.assert_array_equal(np.array(ends)[:, 1], alone[2])


def test_finished_cars_say_how_it_went():
  env = FleetVecEnv(make_fleet([0, 1], "bicycle", sensed=False, lost=0.08))
  env.reset()
  total, steps, last = 0.0, 0, None
  for _ in range(500):
    before = env.fleet.cross_track[0]
    _, reward, done, infos = env.step(np.array([[1.5], [0.0]], dtype=np.float32))
    total, steps = total + float(reward[0]), steps + 1
    if done[0]:
      last = infos[0]
      break
  assert last is not None and not last["TimeLimit.truncated"] and not last["episode"]["finished"]
  assert last["episode"]["l"] == steps and last["episode"]["r"] == pytest.approx(total, rel=1e-5)
  assert abs(before) < 0.08 <= abs(last["terminal_observation"][0])
  assert env.fleet.episode_steps[0] == 0 and env.fleet.episode_steps[1] == steps


def test_a_mask_begins_some_cars_anew_and_no_seed_overrules_it():
  env, mask = FleetVectorEnv(make_fleet([0, 1], "bicycle", sensed=False)), np.array([True, False])
  env.reset(seed=3)
  for _ in range(3):
    env.step(np.zeros((2, 1), dtype=np.float32))
  with pytest.raises(ValueError, match="seed and a reset_mask"):
    env.reset(seed=3, options={"reset_mask": mask})
  assert env.fleet.episode_steps.tolist() == [3, 3]
  env.reset(options={"reset_mask": mask})
  assert env.fleet.episode_steps.tolist() == [0, 3]


def test_vector_environment_answers_what_stable_baselines_asks():
  env = FleetVecEnv(make_fleet([0, 1], "bicycle", sensed=False))
  assert (
    env.num_envs == 2 and env.env_is_wrapped(object) == [False, False] and env.get_attr("render_mode") == [None] * 2
  )
  with pytest.raises(NotImplementedError, match="dance"):
    env.env_method("dance")


@pytest.mark.parametrize("plant", ["twin", "bicycle"])
def test_dm_control_drives_the_same_trajectory(plant):
  rates = actions(150, 1)[:, 0].astype(np.float32)
  seen, rewards, _ = gym_run(rates, plant)
  dm = environment(make_fleet([SEED], plant, lost=0.08), flat_observation=True)
  values, paid = [dm.reset().observation["observations"]], []
  for rate in rates:
    step = dm.step(np.array([rate], dtype=np.float64))
    paid.append(step.reward)
    values.append((dm.reset() if step.last() else step).observation["observations"])
  np.testing.assert_array_equal(np.stack(values).astype(np.float32), seen)
  np.testing.assert_array_equal(np.array(paid), rewards)


def test_dm_control_says_what_it_takes_and_gives_and_how_it_ends():
  dm = environment(make_fleet([0], "bicycle", sensed=False))
  assert dm.action_spec().minimum == -1.5 and dm.action_spec().maximum == 1.5
  assert list(dm.observation_spec()) == list(OBSERVATIONS)
  dm.reset()
  assert dm.control_timestep() == pytest.approx(0.01)
  for _ in range(400):
    step = dm.step(np.array([1.5]))
    if step.last():
      break
  assert step.discount == 0.0 and abs(dm.task.fleet.cross_track[0]) >= 0.2
  again = dm.step(np.array([1.5]))
  assert again.first() and dm.task.fleet.episode_steps[0] == 0


def test_dm_control_shows_the_car_where_it_is():
  dm = environment(make_fleet([3], "twin", sensed=False))
  dm.reset()
  for _ in range(40):
    dm.step(np.array([0.5]))
  shown, true = dm.physics.named.data.xpos["chassis"], dm.task.fleet.signals[0]
  np.testing.assert_allclose(shown[:2], true[:2], atol=1e-12)
  knuckles = [dm.physics.named.data.qpos[f"{side}_steering"][0] for side in ("front_left", "front_right")]
  assert np.mean(knuckles) == pytest.approx(true[9]) and knuckles[0] > knuckles[1]
  assert dm.physics.time() == pytest.approx(0.4)


def test_seeding_the_task_begins_anew():
  dm = environment(make_fleet([3], "bicycle"))
  first = [dm.reset().observation["cross_track_error"]] + [
    dm.step([0.3]).observation["heading_error"] for _ in range(5)
  ]
  dm.task.seed(3)
  again = [dm.reset().observation["cross_track_error"]] + [
    dm.step([0.3]).observation["heading_error"] for _ in range(5)
  ]
  np.testing.assert_array_equal(first, again)


def test_suite_lists_names_and_knows_the_nearest():
  suite = Suite({"track_s": lambda seed: make_fleet([seed], "bicycle"), "track_o": lambda seed: make_fleet([seed])})
  assert suite.names == ("track_s", "track_o")
  assert suite.load("track_s", seed=4).reset().first()
  with pytest.raises(KeyError, match="did you mean track_o"):
    suite.load("trak_o")


def test_gymnasium_environment_shows_pictures_when_asked():
  from qcar_twin.rendering.film import RenderingUnavailable

  env = PathTrackingEnv(make_fleet([0], "bicycle", sensed=False), render_mode="rgb_array")
  env.reset(seed=0)
  try:
    before = env.render()
  except RenderingUnavailable as error:
    pytest.skip(str(error))
  for _ in range(30):
    env.step(np.array([1.0], dtype=np.float32))
  after = env.render()
  env.close()
  assert before.shape == (480, 640, 3) and np.any(before != after)
  assert PathTrackingEnv(make_fleet([0], "bicycle", sensed=False)).render() is None
