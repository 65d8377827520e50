"""DDPG with the paper's networks on stable-baselines3.

Actor: two hidden layers of 200 ReLU, one tanh output. Critic: the observation through two layers of 200, the action
through layers of 100 and 200, joined at their last ReLU, one linear output. Observations come in SI units and are
scaled in the network, so that what is exported takes SI units too. Lillicrap et al., Continuous control with deep
reinforcement learning, 2016.
"""

import dataclasses
import time
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from qcar_twin.extras import extra

with extra("Training"):
  import torch
  from stable_baselines3 import DDPG
  from stable_baselines3.common.buffers import ReplayBuffer
  from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise
  from stable_baselines3.common.policies import ContinuousCritic
  from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
  from stable_baselines3.common.type_aliases import ReplayBufferSamples
  from stable_baselines3.common.vec_env import VecEnv
  from stable_baselines3.td3.policies import TD3Policy
  from torch import nn


@dataclasses.dataclass(frozen=True)
class Settings:
  """Of learning; the defaults converge on the training path.

  Attributes:
    episodes: of training; 0 leaves an agent at what it imitated.
    cars: driven side by side.
    actor_rate, critic_rate: learning rates at the start, decayed linearly to `final_rate` of them
      by `settled` of the episodes.
    noise, final_noise: standard deviation of the exploration noise in units of the largest action.
    warm_up: environment steps of random actions before learning.
    steps_per_update: environment steps per gradient step.
    batch, gamma, tau: as usual.  buffer: transitions kept.
    observation_scale: of cross-track error 1/m, its rate s/m, heading error 1/rad, its rate s/rad.
    demonstrations: episodes driven by the demonstrator whose transitions fill the buffer before the first update.
    algorithm: "ddpg"; or "td3": two critics of which the lower counts, the actor moved at every second step, the
      target's action blurred (Fujimoto et al., Addressing function approximation error in actor-critic methods, 2018).
    imitations: episodes of imitating a teacher that sees the truth, before anything else; see
      `agents.learning.imitation`.
    mirror: left and right are learnt as one: half of every batch is seen in a mirror.
  """

  episodes: int = 300
  cars: int = 8
  actor_rate: float = 3e-4
  critic_rate: float = 1e-3
  final_rate: float = 0.1
  settled: float = 0.8
  noise: float = 0.3
  final_noise: float = 0.05
  warm_up: int = 3000
  steps_per_update: int = 8
  batch: int = 64
  gamma: float = 0.99
  tau: float = 0.005
  buffer: int = 400_000
  observation_scale: tuple[float, float, float, float] = (20.0, 5.0, 5.0, 1.0)
  demonstrations: int = 0
  algorithm: Literal["ddpg", "td3"] = "ddpg"
  imitations: int = 0
  mirror: bool = False

  def __post_init__(self) -> None:
    if self.episodes < (0 if self.imitations else 1) or self.cars < 1:
      raise ValueError(f"episodes and cars must be at least 1, got {self.episodes} and {self.cars}")
    if max(self.cars, self.steps_per_update) % min(self.cars, self.steps_per_update):
      raise ValueError(
        f"{self.cars} cars and {self.steps_per_update} steps per update: one must be a multiple of the other"
      )

  def faded(self, done: float, start: float, end: float) -> float:
    """A value that goes linearly from start to end by `settled` of the training; done in [0, 1]."""
    return start + (end - start) * min(done / self.settled, 1.0)


class Scale(BaseFeaturesExtractor):
  """Observations times constants: the networks see numbers of order one."""

  scale: torch.Tensor

  def __init__(self, observation_space, scale: Sequence[float]):
    super().__init__(observation_space, features_dim=len(scale))
    self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))

  def forward(self, observations: torch.Tensor) -> torch.Tensor:
    return observations * self.scale


class TwoPaths(nn.Module):
  """The paper's critic: a path for the observation, one for the action, joined by adding them before their last ReLU.

  Added after it, value would be a function of the observation plus one of the action: the best action would be the
  same everywhere.
  """

  def __init__(self, observations: int, actions: int):
    super().__init__()
    self._split = observations
    self.observation = nn.Sequential(nn.Linear(observations, 200), nn.ReLU(), nn.Linear(200, 200))
    self.action = nn.Sequential(nn.Linear(actions, 100), nn.ReLU(), nn.Linear(100, 200))
    self.value = nn.Linear(200, 1)

  def forward(self, both: torch.Tensor) -> torch.Tensor:
    joined = self.observation(both[:, : self._split]) + self.action(both[:, self._split :])
    return self.value(torch.relu(joined))


class PaperPolicy(TD3Policy):
  """SB3's deterministic policy with the critic of the paper."""

  def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> ContinuousCritic:
    critic = super().make_critic(features_extractor)
    actions = int(np.prod(self.action_space.shape or ()))
    for i in range(critic.n_critics):
      network = TwoPaths(critic.features_extractor.features_dim, actions).to(self.device)
      critic.add_module(f"qf{i}", network)
      critic.q_networks[i] = network
    return critic


class MirrorBuffer(ReplayBuffer):
  """A buffer whose transitions are seen as they were or in a mirror, by the toss of a coin.

  What is seen and the action change sign from left to right, the reward does not.
  """

  def _get_samples(self, batch_inds: NDArray[np.int64], env=None) -> ReplayBufferSamples:
    samples = super()._get_samples(batch_inds, env)
    side = torch.from_numpy(np.random.choice(np.array([-1.0, 1.0], np.float32), (len(batch_inds), 1)))
    return samples._replace(
      observations=side * samples.observations,
      actions=side * samples.actions,
      next_observations=side * samples.next_observations,
    )


class Agent(DDPG):
  """SB3's DDPG with learning rates and exploration that follow the share of training that is done."""

  settings: Settings
  done: float = 0.0
  learning_seconds: float = 0.0

  def train(self, gradient_steps: int, batch_size: int = 100) -> None:
    """Gradient steps, with the time they take."""
    begun = time.perf_counter()
    super().train(gradient_steps, batch_size)
    self.learning_seconds += time.perf_counter() - begun

  def _update_learning_rate(self, optimizers) -> None:
    """Actor's and critic's own rates."""
    factor = self.settings.faded(self.done, 1.0, self.settings.final_rate)
    rates = self.settings.actor_rate, self.settings.critic_rate
    for optimizer, rate in zip(optimizers, rates, strict=True):  # pyright: ignore[reportArgumentType]  # a list of two
      for group in optimizer.param_groups:
        group["lr"] = factor * rate

  def advance(self, done: float) -> None:
    """Tell the agent which share of its training, in [0, 1], is done."""
    self.done = done
    sigma = self.settings.faded(done, self.settings.noise, self.settings.final_noise)
    for noise in self.action_noise.noises:  # type: ignore[union-attr]
      noise._sigma = np.full_like(noise._sigma, sigma)


def make_agent(env: VecEnv, settings: Settings, seed: int, scale: Sequence[float] = ()) -> Agent:
  """An untrained agent for an environment of `settings.cars` cars; torch is held to one thread.

  Networks this small are slower on several threads than on one.

  Args:
    scale: of what is seen beyond the four errors.
  """
  torch.set_num_threads(1)
  base = NormalActionNoise(np.zeros(1), np.full(1, settings.noise))
  agent = Agent(
    PaperPolicy,
    env,
    learning_rate=settings.critic_rate,
    buffer_size=settings.buffer,
    learning_starts=settings.warm_up,
    batch_size=settings.batch,
    tau=settings.tau,
    gamma=settings.gamma,
    train_freq=max(1, settings.steps_per_update // settings.cars),
    gradient_steps=max(1, settings.cars // settings.steps_per_update),
    action_noise=VectorizedActionNoise(base, env.num_envs),
    policy_kwargs={
      "net_arch": [200, 200],
      "features_extractor_class": Scale,
      "features_extractor_kwargs": {"scale": (*settings.observation_scale, *scale)},
      "n_critics": 2 if settings.algorithm == "td3" else 1,
    },
    replay_buffer_class=MirrorBuffer if settings.mirror else None,
    seed=seed,
    device="cpu",
  )
  agent.settings = settings
  if settings.algorithm == "td3":
    agent.policy_delay, agent.target_policy_noise, agent.target_noise_clip = 2, 0.1, 0.2
  return agent


def demonstrate(agent: Agent, episodes: int) -> int:
  """Fill the buffer with transitions of the demonstrator at the wheel; the number of transitions.

  The demonstrator sets an angle, the agent a rate: the action is the rate that leads to the angle within its bound.
  """
  env = agent.env.unwrapped  # type: ignore[union-attr]
  fleet, buffer = env.fleet, agent.replay_buffer  # type: ignore[attr-defined]
  observation, finished, count = env.reset(), 0, 0
  while finished < episodes:
    action = fleet.expert_action()[:, None].astype(np.float32)
    following, reward, done, infos = env.step(action)
    finished += int(np.sum(done))
    last = np.array(following)
    for i in np.flatnonzero(done):
      last[i] = infos[i]["terminal_observation"]
    buffer.add(observation, last, agent.policy.scale_action(action), reward, done, infos)  # type: ignore[union-attr]
    observation, count = following, count + len(action)
  return count


def actor_layers(agent: Agent) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
  """Weights (out, in) and biases (out,) of the actor's layers, in order; copies."""
  return [
    (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
    for layer in agent.actor.mu
    if isinstance(layer, nn.Linear)
  ]
