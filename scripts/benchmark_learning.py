"""Measure where a training's time goes and how fast its parts are.

qcar-twin benchmark-learning --out out/study/timings.json
"""

import dataclasses
import itertools
from pathlib import Path

from agents.studies.timing import (
  batch_shares,
  gradient_steps_per_second,
  pendulum_steps_per_second,
  raw_gradient_steps_per_second,
  steps_per_second,
  training_shares,
)
from qcar_twin.atomic_io import write_json
from qcar_twin.command_line import run_script
from qcar_twin.extras import extra

with extra("Timing a training"):
  import torch

FLEETS = (1, 8, 64, 256)  # cars

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Length of the measurements, in CPU seconds of one core."""

  out: Path
  """JSON file with a sentence per measurement."""
  steps: int = 8000
  """Number of environment steps of the measured training."""
  rounds: int = 3
  """Number of repetitions of every measurement; the fastest is kept."""
  quick: bool = False
  """A tenth of the steps."""


def main(config: Config) -> list[str]:
  """Measure, write, print."""
  torch.set_num_threads(1)
  part = 10 if config.quick else 1
  shares = training_shares(config.steps // part)
  total = shares.pop("total")
  steps = shares.pop("steps")
  said = ", ".join(f"{name} {100.0 * seconds / total:.0f} %" for name, seconds in shares.items())
  sentences = [
    f"a training step of 8 cars (one gradient step per 8 environment steps): {1e3 * total / steps:.3f} ms of CPU "
    f"per environment step; {said}"
  ]
  shares = batch_shares(FLEETS[-1], 1300 // part)
  total, steps = shares.pop("total"), shares.pop("steps")
  said = ", ".join(f"{name} {100.0 * seconds / total:.0f} %" for name, seconds in shares.items())
  sentences.append(
    f"reduced, {FLEETS[-1]} cars driven by the shipped policy: {1e6 * total / steps:.1f} us per 10 ms of car; {said}"
  )
  rounds = range(1 if config.quick else config.rounds)
  seen = (("fekf", "sensors and filter"), ("truth", "truth"))
  for plant, cars, (estimator, shown) in itertools.product(("mujoco", "reduced"), FLEETS, seen):
    periods = max(20, 400 // part // max(1, cars // 16))
    speed = max(steps_per_second(cars, periods, estimator, plant) for _ in rounds)
    face = "gymnasium, 1 car" if cars == 1 else f"VecEnv, {cars} cars"
    sentences.append(
      f"{plant}, {face}, {shown}: {speed:.0f} environment steps per CPU second, {1e6 / speed:.1f} us per 10 ms of car"
    )
  for count in FLEETS:
    speed = max(pendulum_steps_per_second(count, max(20, 400 // part // max(1, count // 16))) for _ in rounds)
    sentences.append(f"Pendulum-v1, {count} in SB3's DummyVecEnv: {speed:.0f} environment steps per CPU second")
  ours = max(gradient_steps_per_second(400 // part) for _ in rounds)
  raw = max(raw_gradient_steps_per_second(400 // part) for _ in rounds)
  sentences.append(
    f"gradient steps per CPU second at batch 64: {ours:.0f} here, {raw:.0f} with stable-baselines3's own DDPG of "
    "200 x 200"
  )
  config.out.parent.mkdir(parents=True, exist_ok=True)
  write_json(config.out, sentences)
  print("\n".join(sentences))
  return sentences


if __name__ == "__main__":
  run_script()
