"""Train agents on twins of cars that conceal an effect, and drive those cars; resumes.

qcar-twin concealed-agents --out out/concealed_agents --first 20 --second 20
"""

import dataclasses
from pathlib import Path

import numpy as np

from agents.control.controllers import FILE
from agents.control.external_plant import ExternalPlant
from agents.learning.evaluate import PlantMaker
from agents.learning.hyperparameters import read_hyperparameters
from agents.learning.trial import quickly
from agents.studies.comparison import drivers_of
from agents.studies.concealed_cars import ONCE, Driven, drive_car, in_markdown, own_options, read_car, train_agent
from calibration.concealed.campaign.cases import Case, draw_steering_cases
from calibration.concealed.campaign.run import VERDICT, diagnosed, drivable
from calibration.diagnosis.search.structure import Effort
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

KEPT = "what is trained, diagnosed and driven stays in --out, the same command goes on with the rest"
NARROW = Effort(singles=5, pairs=2, triples=1, iterations=1)


@dataclasses.dataclass(frozen=True)
class Config:
  """Agents of the single track, of nominal, recalibrated and repaired twins, and of all that a diagnosis believes."""

  out: Path
  """Folder of the study."""
  first: int = 20
  """Number of cars of the first independent kind."""
  second: int = 20
  """Number of cars of the second independent kind."""
  seed: int = 1
  """Seed that decides every car."""
  seeds: tuple[int, ...] = (0,)
  """Seeds of the trainings."""
  steps: int = 3_000_000
  """Environment steps of a training."""
  streams: int = 12
  """Streams of sensor noise on each of O, infinity and C."""
  limit: int = 0
  """Stop after this number of cars that were not driven before; 0 for all."""
  quick: bool = False
  """Train for a few thousand steps, diagnose narrowly, drive two streams."""


def plants_of(case: Case) -> dict[bool, PlantMaker]:
  """The car of a case with its effect and without it."""
  maker = lambda effect: lambda name: (ExternalPlant(drivable(case, effect).begin), np.empty(0))
  return {effect: maker(effect) for effect in (True, False)}  # type: ignore[misc]


def main(config: Config) -> str:
  """Do what is left, up to the limit, write the tables; returns them."""
  hyper = dataclasses.replace(read_hyperparameters("ppo"), steps=config.steps)
  hyper, streams = (quickly(hyper), 2) if config.quick else (hyper, config.streams)
  trained = lambda changes, place: [
    train_agent(hyper, changes, s, config.out / place / f"seed{s}") for s in config.seeds
  ]
  once = {name: trained(changes, f"agents/{name}") for name, changes in ONCE.items()}
  controllers = drivers_of((), (FILE.with_name("controllers_states.toml"),), ("linear_rate",), 0.5)
  cases = [*draw_steering_cases(config.seed, config.first), *draw_steering_cases(config.seed, config.second, "second")]
  driven, new = list[Driven](), 0
  for case in sorted(cases, key=lambda case: case.name.split("_")[::-1]):  # kinds take turns
    folder = config.out / case.name
    if not (file := folder / "driven.json").is_file():
      if config.limit and new == config.limit:
        continue
      diagnosed(case, folder, NARROW if config.quick else Effort())
      own = {name: trained(what, f"{case.name}/agents/{name}") for name, what in own_options(folder).items()}
      drive_car({**once, **own}, folder, plants_of(case), streams, controllers, file)
      new += 1
      print(f"{case.name} driven", flush=True)
    effect = ", ".join(f"{name} x {size:g}" for name, size in case.effects) or "nothing"
    said = (folder / VERDICT).read_text(encoding="utf-8").strip()
    driven.append(read_car(f"{case.name}: {effect}", not case.effects, said, file))
  write_text(config.out / "cars.md", table := in_markdown(driven))
  print(table)
  return table


if __name__ == "__main__":
  run_script()
