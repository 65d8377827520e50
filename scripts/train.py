"""Train the path-tracking agent on the twin.

qcar-twin train --out OUT [--episodes 300] [--seed 1] [--resume]
"""

import dataclasses
from pathlib import Path
from typing import Literal

from agents.learning.ddpg import Settings
from agents.learning.environments import Options
from agents.learning.train import Plan, train
from agents.studies.study import VARIANTS
from qcar_twin.command_line import run_script
from qcar_twin.envs.task import Reward

KEPT = "the last checkpoint stays in --out, --resume goes on from it"


@dataclasses.dataclass(frozen=True)
class Config:
  """One training. A folder that holds one is only continued, by its own plan, with --resume."""

  out: Path
  """Folder of the training."""
  episodes: int = 300
  """Number of training episodes."""
  seed: int = 0
  """Seed of everything random."""
  resume: bool = False
  """Continue from the last checkpoint in the folder."""
  plant: Literal["twin", "reduced", "bicycle"] = "twin"
  """Plant that is driven."""
  twin: str = ""
  """Twin file (TOML) of a calibration or a diagnosis; the nominal twin where empty."""
  estimator: Literal["fekf", "truth"] = "fekf"
  """State the agent receives: the federated filter on noisy sensors, or the truth."""
  demonstrator: str = "lq_ed"
  """Controller the reward compares with; 'none' trains without the demonstrator's term."""
  version: Literal["loose", "tuned"] = "tuned"
  """Version of the demonstrator."""
  demonstrator_weight: float = 1.0
  """Weight m6 of the demonstrator's term in the reward, 1/rad."""
  demonstrations: int = 0
  """Episodes driven by the demonstrator that fill the replay buffer first."""
  near: float = 0.002
  """Cross-track error below which the reward is flat, m."""
  steering_gain: float = 1.0
  """Gain of the steering linkage, dimensionless; agent and filter do not know it."""
  steering_offset: float = 0.0
  """Offset of the steering linkage, deg; agent and filter do not know it."""
  randomise: bool = False
  """Draw the twin's measured parameters for every episode, within their standard deviations."""
  cars: int = 8
  """Number of cars that are driven in parallel."""
  wide: bool = False
  """Train the agent with more observations, which imitates a teacher that sees the truth; no reinforcement learning."""
  quick: bool = False
  """A few short episodes on the single-track model, to test that everything runs."""


def plan_of(config: Config) -> Plan:
  """The training a configuration asks for."""
  if config.wide:
    wide = VARIANTS["wide"].plan
    options = dataclasses.replace(wide.options, twin=config.twin, plant="bicycle" if config.quick else config.plant)
    settings = dataclasses.replace(wide.settings, imitations=6 if config.quick else wide.settings.imitations)
    return dataclasses.replace(wide, options=options, settings=settings, seed=config.seed)
  none = config.demonstrator == "none"
  reward = Reward(near=config.near, m6=0.0 if none else config.demonstrator_weight)
  options = Options(
    plant="bicycle" if config.quick else config.plant,
    twin=config.twin,
    estimator="truth" if config.quick else config.estimator,
    demonstrator="" if none else config.demonstrator,
    version=config.version,
    steering_gain=config.steering_gain,
    steering_offset=config.steering_offset,
    randomise=config.randomise,
    reward=reward,
  )
  episodes = min(config.episodes, 24) if config.quick else config.episodes
  settings = Settings(episodes=episodes, cars=config.cars, demonstrations=config.demonstrations)
  if config.quick:
    settings = dataclasses.replace(settings, warm_up=200, steps_per_update=32)
  return Plan(options, settings, config.seed, every=4 if config.quick else 15)


def main(config: Config) -> None:
  """Train, and print the result in a line."""
  result = train(plan_of(config), config.out, resume=config.resume)
  best = result["best_rmse_training_path"]
  outcome = "the car never finished the training path" if best is None else f"best {1e3 * best:.1f} mm RMSE on it"
  print(f"{config.out}: {result['episodes']} episodes in {result['seconds']['total']:.0f} s, {outcome}")


if __name__ == "__main__":
  run_script()
