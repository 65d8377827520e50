"""A head start: the actor learns what a teacher that sees the truth would do, from what sensors and filter give.

The linear rate policy on the true errors is the teacher. In the first round it drives by the estimate, in the others
the student drives; the teacher only says what it would have done, and the actor is fitted to that. So it learns the
teacher's answer to the errors that its own observation makes likely: the filter's bias is taken out. (A teacher at the
wheel would hold the true error at zero and so teach that the estimate says nothing.) Sources: Ross, Gordon and Bagnell,
A reduction of imitation learning to no-regret online learning, AISTATS 2011; Chen et al., Learning by cheating, CoRL
2019.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from agents.control import controllers
from agents.control.linear_rate import LinearRate
from agents.control.model import Model
from agents.control.tuning import Search, tune
from agents.learning.ddpg import Agent
from qcar_twin.extras import extra

with extra("Training"):
  import torch

Array = NDArray[np.float64]
ROUNDS = 3
STEPS, BATCH, RATE = 2500, 512, 2e-3  # of fitting after every round; the rate falls to nothing along a cosine
WANDERING = (0.15, 0.3)  # rad/s, s: size and memory of the noise on the driver's rate
SEARCH = Search(candidates=12, elite=4, generations=5)  # of a teacher for a car of its own
CUT = 3.0  # of the teacher's answer before tanh, in units of the largest rate


def teacher(model: Model, speed: float, twin_file: str = "", search: Search = SEARCH) -> LinearRate:
  """The tuned linear rate policy; for a car of its own (a twin file), tuned on that car beginning from there.

  What is right for the nominal car need not be for another: 80 ms of delay in the steering ask for other gains.
  """
  tuned = controllers.load(model.car, speed)["linear_rate", "tuned"]
  assert isinstance(tuned, LinearRate)
  if not twin_file:
    return tuned
  plant, theta = model.plant("mujoco", twin_file)
  family = dataclasses.replace(controllers.FAMILIES["linear_rate"], start=tuple(tuned.gain.tolist()))
  search = dataclasses.replace(search, speed=speed, servo=(0.0, 0.0))  # a twin has its own
  numbers = tune(family, plant, theta, model.car, model.filter_settings("mujoco"), search).numbers
  return dataclasses.replace(tuned, gain=np.array([numbers[name] for name in family.numbers]))


def imitate(agent: Agent, law: LinearRate, episodes: int, seed: int) -> float:
  """Drive, ask the teacher, fit the actor; transitions also go into the replay buffer.

  Args:
    agent: whose environment is driven.
    law: the teacher, asked with true errors.
    episodes: in all, over the rounds.

  Returns:
    Root mean square difference between student and teacher in the last fit, rad/s, before both are bounded.
  """
  rng = np.random.default_rng([seed, 3])
  seen: list[Array] = []
  wanted: list[Array] = []
  error = float("nan")
  for turn in range(ROUNDS):
    observations, answers = _drive(agent, law, max(1, episodes // ROUNDS), turn > 0, rng)
    seen.append(observations)
    wanted.append(answers)
    error = _fit(agent, np.concatenate(seen), np.concatenate(wanted), rng)
  agent.actor_target.load_state_dict(agent.actor.state_dict())
  return law.largest * error


def _drive(
  agent: Agent, law: LinearRate, episodes: int, student: bool, rng: np.random.Generator
) -> tuple[Array, Array]:
  """Observations (K, n) and the teacher's answers (K, 1) in units of the largest rate."""
  env, buffer = agent.env.unwrapped, agent.replay_buffer  # type: ignore[union-attr]
  fleet, observation, finished = env.fleet, env.reset(), 0  # type: ignore[attr-defined]
  size, memory = WANDERING
  fade = math.exp(-fleet.task.period / memory)
  noise, seen, wanted = np.zeros(fleet.count), [], []
  while finished < episodes:
    seen.append(observation)
    wanted.append(-fleet.errors.observation[1] @ law.gain[:, None] / law.largest)
    rate = (
      agent.predict(np.asarray(observation), deterministic=True)[0][:, 0] if student else law.answer(fleet.observation)
    )
    noise = fade * noise + size * math.sqrt(1.0 - fade**2) * rng.standard_normal(fleet.count)
    rate = np.clip(rate + noise, -law.largest, law.largest).astype(np.float32)[:, None]
    following, reward, done, infos = env.step(rate)
    last = np.array(following)
    for i in np.flatnonzero(done):
      last[i] = infos[i]["terminal_observation"]
    buffer.add(observation, last, rate / law.largest, reward, done, infos)  # type: ignore[union-attr]
    finished += int(np.sum(done))
    observation = following
  return np.concatenate(seen), np.clip(np.concatenate(wanted), -CUT, CUT)


def _fit(agent: Agent, seen: Array, wanted: Array, rng: np.random.Generator) -> float:
  """Least squares of the actor before its tanh against the answers; the root of the last hundred steps' mean loss."""
  x, y = torch.tensor(seen, dtype=torch.float32), torch.tensor(wanted, dtype=torch.float32)
  network = torch.nn.Sequential(agent.actor.features_extractor, agent.actor.mu[:-1])
  optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=1e-3, fused=True)
  fading = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS)
  losses = []
  for _ in range(STEPS):
    rows = torch.from_numpy(rng.integers(len(x), size=BATCH))
    side = 1.0 - 2.0 * torch.from_numpy(rng.integers(2, size=(BATCH, 1))).float() if agent.settings.mirror else 1.0
    loss = torch.nn.functional.mse_loss(network(side * x[rows]), side * y[rows])
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    fading.step()
    losses.append(float(loss.detach()))
  return float(np.sqrt(np.mean(losses[-100:])))
