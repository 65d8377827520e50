"""Drive policies against the model-based controllers on O, infinity and C.

qcar-twin evaluate --out OUT [--policy DIR | model.zip] [--mismatch] [--plants mujoco bicycle proving_ground]
"""

import dataclasses
import itertools
from pathlib import Path

import numpy as np

from agents.control.external_plant import ExternalPlant
from agents.control.figures import lane_change_figure, tracking_figure
from agents.learning.evaluate import EvaluationCase, evaluate, known_plant, run_case, write_evaluation
from agents.learning.policy_file import SHIPPED
from agents.learning.sb3_zip import any_policy
from calibration.concealed.proving_ground.onboard import sized
from calibration.concealed.proving_ground.plant import ProvingGroundPlant
from qcar_twin.command_line import run_script
from qcar_twin.plant import Plant
from qcar_twin.twin.file import load_twin

POSITIVE = ("cars", "speeds")


@dataclasses.dataclass(frozen=True)
class Config:
  """Policies and circumstances that are compared."""

  out: Path
  """Folder for evaluation.json, evaluation.txt and figures."""
  policy: tuple[Path, ...] = (SHIPPED,)
  """Policy folders, or zips of stable-baselines3; those of one kind, such as seeds, are summed up as one contestant."""
  paths: tuple[str, ...] = ("o", "infinity", "c")
  """Paths to follow: s, o, infinity, c, random:SEED, or a CSV file of points x, y in m."""
  plants: tuple[str, ...] = ("mujoco",)
  """What is driven: mujoco, reduced, bicycle, proving_ground, or a twin file (TOML)."""
  speeds: tuple[float, ...] = (0.5,)
  """Reference speeds, m/s."""
  mismatch: bool = False
  """Drive every case also with a steering gain of 0.92 and an offset of 1 deg that no controller knows."""
  effects: tuple[str, ...] = ()
  """Concealed effects of the car of --plants proving_ground as name=size, in multiples of the typical magnitude."""
  cars: int = 4
  """Number of cars per case, each with sensor noise of its own."""
  seed: int = 500
  """Seed of the sensor noise."""
  workers: int = 1
  """Number of processes."""
  ray: bool = False
  """Run on the Ray cluster at hand instead of in local processes; needs the extra 'cluster'."""
  quick: bool = False
  """Drive one car on the S-path, against the tuned controllers only."""


def ground(effects: tuple[str, ...]) -> ExternalPlant:
  """The independent car with concealed effects, each name=size."""
  return ExternalPlant(ProvingGroundPlant(effects=tuple(map(sized, effects))).begin, ProvingGroundPlant.period)


def main(config: Config) -> None:
  """Drive all cases, write the results, print the table."""
  effects = config.effects
  if effects and "proving_ground" not in config.plants:
    raise ValueError("--effects are of the independent car: add --plants proving_ground, or leave them out")

  def plant(name: str) -> tuple[Plant, np.ndarray]:
    if name == "proving_ground":
      return ground(effects), np.empty(0)  # type: ignore[return-value]
    return load_twin(name, threads=1) if name.endswith(".toml") else known_plant(name)

  paths = ("s",) if config.quick else config.paths
  wrong = [(1.0, 0.0)] + [(0.92, 1.0)] * config.mismatch
  cars = 1 if config.quick else config.cars
  cases = [
    EvaluationCase(path, name, speed, gain, offset, cars, config.seed)
    for name, speed, (gain, offset), path in itertools.product(config.plants, config.speeds, wrong, paths)
  ]
  read = [any_policy(folder) for folder in config.policy]
  kinds = {f"{policy.name} {k}": policy.name for k, policy in enumerate(read)}
  policies = dict(zip(kinds, config.policy, strict=True))
  versions = ("tuned",) if config.quick else ("loose", "tuned")
  rows = evaluate(policies, cases, plant, config.workers, config.ray, versions)
  for folder, policy in zip(config.policy, read, strict=True):
    print(f"{folder}: {policy.about}")
  print(write_evaluation(config.out, rows, lambda label: kinds.get(label, label), policies))
  for case in cases[: len(paths)]:
    drives = {read[0].name: run_case(read[0], case, plant)}
    tracking_figure(drives, config.out / f"tracking_{figure_name(case.path)}.png")
    if drives[read[0].name].path.lanes:
      lane_change_figure(drives, config.out / "lane_change.png")


def figure_name(path: str) -> str:
  """A path's name as part of a file's."""
  return Path(path).stem.replace(":", "_")


if __name__ == "__main__":
  run_script()
