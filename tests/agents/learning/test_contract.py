"""What every plant and every face of the environment promises, on every plant."""

import concurrent.futures
import copy
import dataclasses
import multiprocessing
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasium_check
from stable_baselines3.common.env_checker import check_env as sb3_check

from agents.learning.environments import ENV_ID, Options, fleet, make_env, make_vector_env
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.envs.vector_env import FleetVecEnv
from qcar_twin.plant import Segments
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

VEHICLE = Vehicle.load()
PLANTS = {
  "mujoco": lambda: Twin(VEHICLE, threads=1),
  "reduced": lambda: Twin(VEHICLE, threads=1, engine="reduced"),
  "bicycle": lambda: Bicycle(VEHICLE),
}
ESTIMATORS = ("fekf", "truth")
SPAWN = {"context": "spawn"}  # a process that has threads is not forked
every_plant = pytest.mark.parametrize("plant", list(PLANTS))
every_face = pytest.mark.parametrize("face", ["gymnasium", "vector", "stable-baselines3", "dm_control"])


class Face:
  """One car of a face as `reset(seed) -> observation` and `step(action) -> observation, reward, ended`."""

  def __init__(self, kind, plant, estimator="fekf", seed=None):
    self.kind, options = kind, {"plant": plant, "estimator": estimator}
    if kind == "gymnasium":
      self.env = make_env(**options)
    elif kind == "vector":
      self.env = make_vector_env(2, **options)
    else:
      cars = fleet(Options(**options), [0, 1] if kind == "stable-baselines3" else [0])
      if kind == "stable-baselines3":
        self.env = FleetVecEnv(cars, normalised=True, seeded=False)
      else:
        from qcar_twin.envs.dm_env import environment

        self.env = environment(cars, flat_observation=True)

  def reset(self, seed=None):
    if self.kind == "gymnasium":
      return self.env.reset(seed=seed)[0]
    if self.kind == "vector":
      return self.env.reset(seed=seed)[0][0]
    if self.kind == "stable-baselines3":
      if seed is not None:
        self.env.seed(seed)
      return self.env.reset()[0]
    if seed is not None:
      self.env.task.seed(seed)
    return self.env.reset().observation["observations"]

  def step(self, action):
    if self.kind == "gymnasium":
      seen, reward, lost, over, _ = self.env.step(np.array([action], np.float32))
      return seen, reward, lost or over
    both = np.full((2, 1), action, np.float32)
    if self.kind == "vector":
      seen, reward, lost, over, _ = self.env.step(both)
      return seen[0], reward[0], bool(lost[0] or over[0])
    if self.kind == "stable-baselines3":
      seen, reward, done, _ = self.env.step(both)
      return seen[0], reward[0], bool(done[0])
    step = self.env.step(np.array([action]))
    if step.first():
      return step.observation["observations"], 0.0, False
    return step.observation["observations"], step.reward, step.last()


# -- plants --------------------------------------------------------------------------------------


def stretches(seed):
  """Two segments of a random drive."""
  commands = np.random.default_rng(seed).uniform([0.5, -0.3], [1.5, 0.3], (2, 40, 2))
  start = np.tile([0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0], (2, 1))
  return Segments(commands, start, np.full(2, 40), 0.01, ("a", "b"), np.zeros(2))


@every_plant
def test_threads_that_share_a_plant_get_their_own_rollouts(plant):
  shared = PLANTS[plant]()
  theta, segments = shared.parameters.nominal, [stretches(seed) for seed in range(4)]
  alone = [shared.rollout(theta, some).signals for some in segments]
  with concurrent.futures.ThreadPoolExecutor(4) as pool:
    together = list(pool.map(lambda k: shared.rollout(theta, segments[k % 4]).signals, range(24)))
  for k, signals in enumerate(together):
    np.testing.assert_array_equal(signals, alone[k % 4])


@every_plant
def test_a_plant_that_has_driven_is_pickled_and_drives_the_same(plant):
  there = PLANTS[plant]()
  before = there.rollout(there.parameters.nominal, stretches(0)).signals
  again = pickle.loads(pickle.dumps(there))
  np.testing.assert_array_equal(again.rollout(again.parameters.nominal, stretches(0)).signals, before)


@dataclasses.dataclass
class Slow:
  """A plant of another period."""

  period: float = 0.02

  def __post_init__(self):
    self._bicycle = Bicycle(VEHICLE)
    self.parameters = self._bicycle.parameters

  def begin(self, theta, start):
    made = self._bicycle.begin(theta, start)
    once = made.step

    def twice(commands):
      once(commands)
      return once(commands)

    made.step = twice
    return made


def test_the_plant_owns_the_clock():
  """A plant of 20 ms: its periods take the car as far as twice as many of 10 ms; sensors that can't keep up say so."""
  options, theta = Options(plant="bicycle", estimator="truth"), Bicycle(VEHICLE).parameters.nominal
  slow, usual = fleet(options, [3], own_plant=(Slow, theta)), fleet(options, [3])
  assert slow.task.period == 0.02 and slow.task.longest == -(-usual.task.longest // 2)
  for _ in range(50):
    slow.step(np.zeros(1))
    for _ in range(2):
      usual.step(np.zeros(1))
  assert slow.arc_length[1, 0] == pytest.approx(usual.arc_length[1, 0], rel=0.02)
  with pytest.raises(ValueError, match="100 Hz does not divide the control rate of 50 Hz"):
    fleet(dataclasses.replace(options, estimator="fekf"), [3], own_plant=(Slow, theta))


# -- faces ---------------------------------------------------------------------------------------


def drive(face, actions):
  seen, rewards = [], []
  for action in actions:
    observation, reward, _ = face.step(action)
    seen.append(np.array(observation))
    rewards.append(reward)
  return np.array(seen), np.array(rewards)


@every_plant
@every_face
def test_a_seed_reproduces_and_none_is_random(face, plant):
  actions = np.random.default_rng(0).uniform(-0.3, 0.3, 30)
  first, again = (Face(face, plant) for _ in range(2))
  np.testing.assert_array_equal(first.reset(seed=5), again.reset(seed=5))
  for one, other in zip(drive(first, actions), drive(again, actions), strict=True):
    np.testing.assert_array_equal(one, other)
  assert not np.array_equal(first.reset(seed=6), again.reset(seed=5))
  if face != "dm_control":  # dm_control has no reset without a seed of the task's own
    assert not np.array_equal(Face(face, plant).reset(), Face(face, plant).reset())


@every_plant
def test_unseeded_cars_and_workers_differ(plant):
  starts = make_vector_env(4, plant=plant).reset()[0][:, 0]
  assert len(set(starts.tolist())) == 4
  vector = gymnasium.make_vec(
    f"agents.learning.environments:{ENV_ID}", num_envs=3, vectorization_mode="sync", plant=plant
  )
  assert len(set(vector.reset()[0][:, 0].tolist())) == 3
  workers = gymnasium.make_vec(
    f"agents.learning.environments:{ENV_ID}", num_envs=2, vectorization_mode="async", vector_kwargs=SPAWN, plant=plant
  )
  assert len(set(workers.reset()[0][:, 0].tolist())) == 2
  workers.close()
  cars = FleetVecEnv(fleet(Options(plant=plant), [0, 0, 0]), seeded=False)
  assert len(set(cars.reset()[:, 0].tolist())) == 3


@every_plant
@every_face
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_rewards_are_finite_whatever_the_action(face, plant, wrong):
  env = Face(face, plant)
  env.reset(seed=1)
  _, reward, ended = env.step(wrong)
  assert np.isfinite(reward) and ended == np.isnan(wrong)
  if ended and face in ("gymnasium", "dm_control"):
    env.reset()
  seen, rewards = drive(env, np.zeros(20))
  assert np.isfinite(seen).all() and np.isfinite(rewards).all()


@pytest.mark.parametrize(
  "wrong, said",
  [
    ({"estimator": "ekf"}, "no estimator 'ekf': did you mean fekf"),
    ({"plant": "bycicle"}, "did you mean bicycle"),
    ({"plant": "twin"}, "no plant 'twin': did you mean mujoco"),
    ({"path": "infinty"}, "did you mean infinity"),
    ({"demonstrator": "lq_e"}, "did you mean lq_ed"),
    ({"version": "tune"}, "did you mean tuned"),
    ({"observation": "wid"}, "did you mean wide"),
    ({"unknown": "steering_gains"}, "did you mean 'steering_gain'"),
    ({"estimater": "truth"}, "did you mean estimator"),
    ({"render_mode": "human"}, "no render mode 'human'"),
    ({"stretch": 1000.0}, "a stretch of 1000 m of path .s., which has 6.4 m"),
    ({"friction": 3.0}, "no option .friction.; there are path, speed"),
    ({"speed": "fast"}, "speed is 'fast'; it must be a number, as 0.5"),
    ({"laps": 0}, "laps is 0; it must be positive"),
    ({"laps": 2}, "2 laps of path 's', which is open: leave laps out, or take a closed one"),
    ({"laps": 1.5}, "laps is 1.5; it must be a whole number"),
    ({"substeps": 0}, "substeps is 0; it must be positive"),
    ({"steering_gain": np.nan}, "steering_gain is nan; it must be finite"),
    ({"gain_spread": 5.0}, "could turn the steering round"),
    ({"gain_spread": -0.1}, "gain_spread is -0.1; it must not be negative"),
    ({"start_offset": np.inf}, "start_offset is inf; it must be finite"),
    ({"reward": {"near": -1.0}}, "near is -1; it must be positive"),
    ({"reward": {"m2": np.nan}}, "m2 is nan; it must be finite"),
    (
      {"path": "there_is_none.csv"},
      "there_is_none.csv: no such file; a path of one's own is a CSV file of two columns",
    ),
  ],
)
def test_a_choice_there_is_not_is_refused_with_the_nearest(wrong, said):
  with pytest.raises((FileNotFoundError, KeyError, TypeError, ValueError), match=said):
    make_env(**{"plant": "reduced", **wrong})


@every_plant
@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("how", ["snapshot", "pickle", "deepcopy"])
def test_a_drive_goes_on_from_where_it_was_kept(plant, estimator, how):
  env = make_env(plant=plant, estimator=estimator)
  env.reset(seed=2)
  actions = np.random.default_rng(1).uniform(-0.4, 0.4, (60, 1)).astype(np.float32)
  for action in actions[:25]:
    env.step(action)
  if how == "snapshot":
    kept = env.snapshot()
    expected = [env.step(action)[:2] for action in actions[25:]]
    env.restore(kept)
    other = env
  else:
    other = pickle.loads(pickle.dumps(env)) if how == "pickle" else copy.deepcopy(env)
    expected = [env.step(action)[:2] for action in actions[25:]]
  for action, (seen, reward) in zip(actions[25:], expected, strict=True):
    again = other.step(action)
    np.testing.assert_array_equal(again[0], seen)
    assert again[1] == reward


@every_plant
@pytest.mark.parametrize("face", ["vector", "stable-baselines3", "dm_control"])
@pytest.mark.parametrize("how", ["pickle", "deepcopy"])
def test_a_drive_of_the_other_faces_goes_on_in_a_copy(plant, face, how):
  there = Face(face, plant)
  there.reset(seed=2)
  actions = np.random.default_rng(1).uniform(-0.4, 0.4, 40)
  drive(there, actions[:15])
  other = pickle.loads(pickle.dumps(there)) if how == "pickle" else copy.deepcopy(there)
  for one, same in zip(drive(there, actions[15:]), drive(other, actions[15:]), strict=True):
    np.testing.assert_array_equal(one, same)


@every_plant
def test_the_checkers_of_gymnasium_and_stable_baselines_have_nothing_to_say(plant):
  with warnings.catch_warnings():
    warnings.simplefilter("error")
    env = gymnasium.make(f"agents.learning.environments:{ENV_ID}", plant=plant, estimator="truth")
    gymnasium_check(env.unwrapped, skip_render_check=True)
    sb3_check(env.unwrapped)


@every_plant
def test_the_reward_is_the_sum_of_the_terms_that_are_told(plant):
  env, many = make_env(plant=plant), make_vector_env(3, plant=plant)
  env.reset(seed=0)
  _, reward, *_, info = env.step(np.array([0.3], np.float32))
  assert set(info["reward_terms"]) == {"cross_track", "heading", "steering_rate", "demonstrator"}
  assert sum(info["reward_terms"].values()) == pytest.approx(reward)
  many.reset(seed=0)
  _, rewards, *_, info = many.step(np.full((3, 1), 0.3, np.float32))
  np.testing.assert_allclose(sum(info["reward_terms"].values()), rewards)
  assert rewards[0] == reward


def test_a_finished_car_of_the_vector_environment_says_how_it_ended():
  env = make_vector_env(2, plant="bicycle", estimator="truth")
  env.reset(seed=0)
  for _ in range(400):
    seen, _, lost, _, info = env.step(np.array([[1.0], [0.0]], np.float32))
    if lost[0]:
      break
  assert info["_final_obs"].tolist() == [True, False] and abs(info["final_obs"][0, 0]) >= 20.0 * 0.2
  assert abs(seen[0, 0]) <= 20.0 * 0.05 + 1e-6 and env.fleet.episode_steps.tolist()[0] == 0


# -- pictures ------------------------------------------------------------------------------------


def _picture(connection, env):
  try:
    connection.send(env.render().shape)
  except Exception as error:
    connection.send(f"{type(error).__name__}: {error}")


def _of_process(method, env):
  context = multiprocessing.get_context(method)
  here, there = context.Pipe()
  process = context.Process(target=_picture, args=(there, env))
  with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # of forking a process that has threads
    process.start()
  said = here.recv() if here.poll(60) else "hangs"
  process.join(5)
  process.kill()
  return said


def test_pictures_come_from_threads_and_spawned_processes_and_are_refused_after_a_fork():
  from qcar_twin.rendering.film import RenderingUnavailable

  env = make_env("rgb_array", plant="bicycle", estimator="truth")
  env.reset(seed=0)
  try:
    first = env.render()
  except RenderingUnavailable as error:
    pytest.skip(str(error))
  with concurrent.futures.ThreadPoolExecutor(2) as pool:
    for picture in pool.map(lambda _: env.render(), range(4)):
      assert picture.shape == first.shape
  assert "before this process was forked" in _of_process("fork", env)
  assert _of_process("spawn", env) == first.shape
  env.close()
