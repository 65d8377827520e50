"""Train a path-tracking agent on the twin.

qcar-twin train --out OUT [--algorithm ppo] [--hyperparameters FILE.yml] [--path random:1:400] [--seed 1] [--resume]
"""

import dataclasses
from pathlib import Path
from typing import Literal

from agents.learning.by_reward import train_by_reward
from agents.learning.train import train
from agents.learning.trial import in_words, is_by_reward, trial_from
from agents.studies.study import plan_from
from qcar_twin.command_line import run_script

KEPT = "a checkpoint stays in --out where one was written by then, and --resume goes on from it"

POSITIVE = ("cars", "episodes")


@dataclasses.dataclass(frozen=True)
class Config:
  """One training. A folder that holds one is only continued, by its own plan, with --resume."""

  out: Path
  """Folder of the training."""
  algorithm: Literal["paper", "ppo", "sac", "td3", "ddpg"] = "paper"
  """Training algorithm: the paper's DDPG with a demonstrator, or one of stable-baselines3 by reward alone."""
  hyperparameters: Path | None = None
  """YAML file of --algorithm's hyperparameters as the RL zoo's; the package's own without it."""
  path: str = ""
  """Path of the training: s, o, infinity, c, random:SEED[:LENGTH] or FILE.csv; empty for the algorithm's own choice."""
  observation: Literal["auto", "errors", "wide", "history", "any_speed"] = "auto"
  """What an agent that learns by reward alone sees. Four errors; also command, curvature and their means; the last
  second instead of the means; all of that with the speed. By auto, the hyperparameters say."""
  critic: Literal["auto", "own", "truth"] = "auto"
  """What the critic of a training by reward alone sees: what the agent sees, or also the truth; auto: the truth for
  ppo."""
  workers: int = 1
  """Number of processes that drive the cars of a training by reward alone."""
  device: str = "cpu"
  """Device of torch's for the networks of a training by reward alone, such as cuda."""
  tensorboard: bool = True
  """Write curves for TensorBoard into the folder."""
  episodes: int = 300
  """Number of training episodes (paper)."""
  seed: int = 0
  """Seed of everything random."""
  resume: bool = False
  """Continue from the last checkpoint in the folder."""
  plant: Literal["auto", "mujoco", "reduced", "bicycle"] = "auto"
  """What is driven; auto: the twin in MuJoCo for the paper's training, what the hyperparameters say by reward alone."""
  twin: str = ""
  """Twin file (TOML) of a calibration or a diagnosis; the nominal twin where empty."""
  estimator: Literal["fekf", "truth"] = "fekf"
  """State the agent receives: the federated filter on noisy sensors, or the truth."""
  unknown: tuple[str, ...] = ()
  """Parameters that the filter estimates as extra states, as `track` does; none: the plain filter of the shipped
  agents."""
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
  randomise: Literal["none", "prior", "posterior"] = "none"
  """What is drawn for every episode: the twin's measured parameters within their standard deviations, or models and
  parameters by the posterior of --diagnosis."""
  diagnosis: str = ""
  """Folder of a diagnosis, whose twin is driven."""
  informed: bool = False
  """Give the filter the steering and delays, but no sensor errors, of --twin or of the diagnosis's twin."""
  cars: int = 8
  """Number of cars that are driven in parallel."""
  wide: bool = False
  """Train the agent with more observations, which imitates a teacher that sees the truth; no reinforcement learning."""
  quick: bool = False
  """A few short episodes on the single-track model, to test that everything runs."""


def main(config: Config) -> None:
  """Train, and print the result in a line."""
  asked, defaults = vars(config), {f.name: f.default for f in dataclasses.fields(Config)}
  if config.algorithm != "paper" or (config.resume and is_by_reward(config.out)):
    trial = trial_from(asked, defaults)
    how = {name: asked[name] for name in ("resume", "tensorboard", "device", "workers")}
    result = train_by_reward(trial, config.out, **how)
    print(f"{config.out}: {in_words(result)}")
    return
  result = train(plan_from(asked, defaults), config.out, resume=config.resume)
  best = result["best_rmse_training_path"]
  outcome = "the car never finished the training path" if best is None else f"best {1e3 * best:.1f} mm RMSE on it"
  print(f"{config.out}: {result['episodes']} episodes in {result['seconds']['total']:.0f} s, {outcome}")


if __name__ == "__main__":
  run_script()
