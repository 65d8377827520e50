"""Where a training's time goes, and how fast environments and gradient steps are; all in one run, in CPU seconds."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from agents.learning.ddpg import Settings, make_agent
from agents.learning.environments import Options, fleet, make_env
from agents.learning.policy_file import SHIPPED, load_policy
from agents.learning.trial import TRACKS
from qcar_twin.envs.fleet import Fleet
from qcar_twin.envs.spaces import Interface
from qcar_twin.envs.vector_env import FleetVecEnv
from qcar_twin.extras import extra

with extra("Timing a training"):
  import gymnasium
  from stable_baselines3 import DDPG
  from stable_baselines3.common.logger import Logger
  from stable_baselines3.common.vec_env import DummyVecEnv


@dataclasses.dataclass
class Watch:
  """CPU seconds of a part of the work."""

  seconds: float = 0.0

  def around(self, work: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, watched."""

    def watched(*args: Any, **named: Any) -> Any:
      begun = time.process_time()
      try:
        return work(*args, **named)
      finally:
        self.seconds += time.process_time() - begun

    return watched


@contextmanager
def watching(fleet_: Fleet) -> Iterator[dict[str, Watch]]:
  """Watch physics, sensors and filter of a fleet."""
  parts = {"physics": Watch(), "sensors and filter": Watch()}
  watched = (
    (fleet_.cars.plant, "physics", ("step", "restart")),
    (fleet_.cars.observer, "sensors and filter", ("observe", "command", "begin")),
  )
  for owner, part, names in watched:
    for name in names:
      setattr(owner, name, parts[part].around(getattr(owner, name)))
  try:
    yield parts
  finally:
    for owner, _, names in watched:
      for name in names:
        delattr(owner, name)


def training_shares(steps: int = 2000) -> dict[str, float]:
  """CPU seconds of a stretch of training by part, after its warm-up: physics, sensors and filter, networks, rest."""
  settings = Settings(warm_up=160)
  env = FleetVecEnv(fleet(Options(version="tuned"), range(settings.cars)))
  agent = make_agent(env, settings, 0)
  agent.set_logger(Logger(None, []))
  agent.learn(settings.warm_up, log_interval=10**6)
  networks = Watch()
  train, predict = agent.train, agent.policy.predict
  with watching(env.fleet) as parts:
    agent.train, agent.policy.predict = networks.around(train), networks.around(predict)  # type: ignore[method-assign]
    begun = time.process_time()
    agent.learn(steps, log_interval=10**6, reset_num_timesteps=False)
    total = time.process_time() - begun
  seconds = {name: part.seconds for name, part in parts.items()} | {"networks": networks.seconds}
  return seconds | {"rest": total - sum(seconds.values()), "total": total, "steps": float(steps)}


def batch_shares(count: int = 256, periods: int = 1300) -> dict[str, float]:
  """CPU seconds of a training's environment by part: the shipped policy drives so many reduced cars with the filter.

  An episode has about 1200 periods. What beginning new ones takes of any part counts as "new episodes".
  """
  policy = load_policy(SHIPPED)
  env = FleetVecEnv(fleet(TRACKS, range(count)), policy.observation, normalised=True)
  begun, cars = Watch(), env.fleet.cars
  parts = {name: Watch() for name in ("physics", "sensors", "sensors and filter", "path", "observation")}
  seen, scale = env.reset(), np.asarray(policy.observation_scale)
  step, restart = Watch(), env.fleet.restart
  for owner, part, name in (
    (cars.plant, "physics", "step"),
    (cars.observer.suite, "sensors", "measure"),  # type: ignore[attr-defined]
    (cars.observer, "sensors and filter", "observe"),
    (cars, "path", "_look"),
    (env, "observation", "_seen"),
  ):
    setattr(owner, name, parts[part].around(getattr(owner, name)))

  def anew(which: Any) -> None:
    before = {name: part.seconds for name, part in parts.items()}
    begun.around(restart)(which)
    for name, part in parts.items():
      part.seconds = before[name]

  env.fleet.restart = anew  # type: ignore[method-assign]
  watched = step.around(env.step)
  for _ in range(periods):
    seen = watched((policy.rate(seen / scale) / policy.largest_rate)[:, None])[0]
  seconds, total = {name: part.seconds for name, part in parts.items()}, step.seconds
  seconds["filter"] = seconds.pop("sensors and filter") - seconds["sensors"]
  seconds["new episodes"] = begun.seconds
  return seconds | {"rest": total - sum(seconds.values()), "total": total, "steps": float(count * periods)}


def steps_per_second(cars: int, periods: int = 400, estimator: str = "fekf", plant: str = "mujoco") -> float:
  """Environment steps of all cars per CPU second: one car through gymnasium, more through the VecEnv."""
  rng = np.random.default_rng(0)
  if cars == 1:
    env: Any = make_env(version="tuned", estimator=estimator, plant=plant)
    env.reset(seed=0)
    step = lambda: env.step(rng.uniform(-0.3, 0.3, 1).astype(np.float32))
  else:
    options = Options(version="tuned", estimator=estimator, plant=plant)  # type: ignore[arg-type]
    vector = FleetVecEnv(fleet(options, range(cars)))
    vector.reset()
    step = lambda: vector.step(rng.uniform(-0.3, 0.3, (cars, 1)).astype(np.float32))
  for _ in range(20):
    step()
  begun = time.process_time()
  for _ in range(periods):
    step()
  return cars * periods / (time.process_time() - begun)


def pendulum_steps_per_second(count: int, periods: int = 400) -> float:
  """Environment steps per CPU second of so many of gymnasium's Pendulum-v1 in stable-baselines3's own VecEnv."""
  env, rng = DummyVecEnv([lambda: gymnasium.make("Pendulum-v1")] * count), np.random.default_rng(0)
  env.reset()
  begun = time.process_time()
  for _ in range(periods):
    env.step(rng.uniform(-2.0, 2.0, (count, 1)).astype(np.float32))
  return count * periods / (time.process_time() - begun)


class Idle(gymnasium.Env):
  """Does nothing, at once: what is left is the library's own time."""

  observation_space = Interface().observation_space
  action_space = gymnasium.spaces.Box(-1.5, 1.5, (1,), np.float32)

  def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
    """Zeros."""
    return np.zeros(4, np.float32), {}

  def step(self, action):
    """Zeros."""
    return np.zeros(4, np.float32), 0.0, False, False, {}


def raw_gradient_steps_per_second(count: int = 400, batch: int = 64) -> float:
  """Of stable-baselines3's own DDPG with two hidden layers of 200, per CPU second."""
  env = DummyVecEnv([Idle])
  agent = DDPG("MlpPolicy", env, policy_kwargs={"net_arch": [200, 200]}, learning_starts=0, device="cpu", seed=0)
  return _gradient_rate(agent, count, batch)


def gradient_steps_per_second(count: int = 400, batch: int = 64) -> float:
  """Of this project's agent, per CPU second."""
  settings = dataclasses.replace(Settings(), cars=1, steps_per_update=1)
  return _gradient_rate(make_agent(DummyVecEnv([Idle]), settings, 0), count, batch)


def _gradient_rate(agent: DDPG, count: int, batch: int) -> float:
  rng = np.random.default_rng(0)
  agent.set_logger(Logger(None, []))
  for _ in range(2 * batch):
    seen, following = rng.standard_normal((2, 1, 4)).astype(np.float32)
    action, reward = rng.uniform(-1.0, 1.0, (1, 1)).astype(np.float32), rng.standard_normal(1)
    agent.replay_buffer.add(seen, following, action, reward, np.zeros(1), [{}])  # type: ignore[union-attr]
  agent.train(20, batch)
  begun = time.process_time()
  agent.train(count, batch)
  return count / (time.process_time() - begun)
