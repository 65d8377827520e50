"""Train agents on twins of cars that conceal an effect, and drive those cars; resumes.

qcar-twin concealed-agents --out out/concealed_agents --first 20 --second 20 --jobs 2
"""

import dataclasses
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from joblib import delayed

from agents.control.controllers import FILE
from agents.control.external_plant import ExternalPlant
from agents.learning.hyperparameters import FOLDER, Hyperparameters, read_hyperparameters
from agents.learning.trial import quickly
from agents.studies.comparison import drivers_of
from agents.studies.concealed_cars import SPEED, Driven, drive_car, in_markdown, read_car, train_its_own, train_once
from calibration.concealed.campaign.cases import Case, draw_steering_cases
from calibration.concealed.campaign.run import VERDICT, all_answered, attempted, diagnosed, drivable
from calibration.diagnosis.search.structure import NARROW, Effort
from calibration.progress import counted
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.parallel import in_parallel

KEPT = "what is trained, diagnosed and driven stays in --out, the same command goes on with the rest"
ANSWER = "driven.json"
APART = 10  # seeds of trainings that a car has to itself, so that what a seed does to a training differs by car


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
  """Seeds of the trainings for each car."""
  seeds_once: tuple[int, ...] = (0, 1, 2)
  """Seeds of the trainings that are for no car in particular."""
  steps: int = 3_000_000
  """Environment steps of a training."""
  streams: int = 12
  """Streams of sensor noise on each of O, infinity and C."""
  jobs: int = 1
  """Number of cars, or trainings, at a time, one core each."""
  score_only: bool = False
  """Train and drive nothing; write the tables of the cars that were driven."""
  quick: bool = False
  """Train for a few thousand steps, diagnose narrowly, drive two streams."""


def drive_with_its_own(case: Case, config: Config, hyper: Hyperparameters, once: Mapping[str, list[Path]]) -> None:
  """Diagnose a car, train the agents of its twins, drive it with them and with those trained once."""
  folder = config.out / case.name
  diagnosed(case, folder, NARROW if config.quick else Effort())
  own = train_its_own(hyper, folder, [(s, APART * case.seed + s) for s in config.seeds])
  streams = 2 if config.quick else config.streams
  plants = {effect: ExternalPlant(drivable(case, effect).begin) for effect in (True, False)}
  controllers = drivers_of((), (FILE.with_name("controllers_states.toml"),), ("linear_rate",), SPEED)
  drive_car({**once, **own}, folder, plants, streams, controllers, folder / ANSWER)


def run(config: Config, cases: list[Case]) -> list[str]:
  """Train and drive what is missing; a line for each car that could not be."""
  hyper = dataclasses.replace(read_hyperparameters("ppo", FOLDER / "ppo_states.yml"), steps=config.steps)
  hyper = quickly(hyper) if config.quick else hyper
  once = train_once(hyper, config.out, config.seeds_once, config.jobs)
  todo = [case for case in cases if not (config.out / case.name / ANSWER).is_file()]
  whole = [partial(drive_with_its_own, case, config, hyper, once) for case in todo]
  calls = [delayed(attempted)(case.name, config.out, call) for case, call in zip(todo, whole, strict=True)]
  return [line for _, line in counted(in_parallel(calls, config.jobs), len(calls), "car")]


def main(config: Config) -> str:
  """Do what is left, write the tables of the cars that were driven; returns them."""
  cases = [*draw_steering_cases(config.seed, config.first), *draw_steering_cases(config.seed, config.second, "second")]
  cases.sort(key=lambda case: case.name.split("_")[::-1])  # kinds take turns, so a study that is stopped has seen both
  said = [] if config.score_only else run(config, cases)
  driven = list[Driven]()
  for case in cases:
    if (file := config.out / case.name / ANSWER).is_file():
      effect = ", ".join(f"{name} x {size:g}" for name, size in case.effects) or "nothing"
      verdict = (config.out / case.name / VERDICT).read_text(encoding="utf-8").strip()
      driven.append(read_car(f"{case.name}: {effect}", not case.effects, verdict, file))
  table = in_markdown(driven) if driven else "No car was driven yet.\n"
  write_text(config.out / "cars.md", table)
  print(table)
  all_answered(said, config.out)
  return table


if __name__ == "__main__":
  run_script()
