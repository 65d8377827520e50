"""Train every agent variant, drive every case and write the page.

qcar-twin study --out out/study [--limit 1] [--page docs/results/learning.md]
"""

import dataclasses
from pathlib import Path

import numpy as np
from joblib import delayed
from numpy.typing import NDArray

from agents.control.external_plant import ExternalPlant
from agents.learning.evaluate import known_plant
from agents.studies.study import VARIANTS, Job, driving_jobs, settings, timed, training_jobs, variant_named
from agents.studies.study_report import page
from calibration.concealed.laboratory.written import stream
from calibration.concealed.proving_ground import Car, ProvingGroundPlant
from calibration.progress import StageLine, staged
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.parallel import in_parallel
from qcar_twin.plant import Plant

GROUND = "proving ground"
KEPT = "jobs that were finished stay in --out, the same command goes on with the others"


@dataclasses.dataclass(frozen=True)
class Config:
  """Jobs of the study. Those whose file is in the folder are done."""

  out: Path
  """Folder of the study."""
  variants: tuple[str, ...] = tuple(VARIANTS)
  """Agents to train. 'recalibrated' and 'repaired' wait for OUT/NAME.toml, the twin they are trained on."""
  seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
  """Seeds of the trainings."""
  few: tuple[int, ...] = (0, 1)
  """Seeds of the agents that are trained on a twin of their own."""
  episodes: int = 300
  """Number of episodes per training."""
  effects: tuple[str, ...] = ("steering_delay=1", "steering_offset=1", "friction_change=1")
  """Concealed effects as name=size, in multiples of the typical magnitude, each driven alone."""
  car: int = -1
  """Seed of the session whose car the recalibrated and repaired twins were made for; -1 for none."""
  concealed: str = "steering_delay=2"
  """Concealed effect of that car as name=size, in multiples of the typical magnitude."""
  limit: int = 0
  """Stop after this number of jobs; 0 for all."""
  workers: int = 1
  """Number of jobs that run in parallel, one core each."""
  ray: bool = False
  """Run on the Ray cluster at hand, not in local processes; its computers have to see --out."""
  page: Path | None = None
  """Markdown file to write from the results that are there."""
  quick: bool = False
  """One seed, a few episodes, two cars, no other speeds and plants."""

  @property
  def special(self) -> tuple[str, ...]:
    """The car that twins were made for, without and with its effect."""
    own = f"{GROUND} car={self.car}"
    return (own, f"{own} {self.concealed}") if self.car >= 0 else ()


def plant(name: str) -> tuple[Plant, NDArray[np.float64]]:
  """A plant by name: as `known_plant`, or "proving ground" followed by car=SEED and effects as name=size."""
  if not name.startswith(GROUND):
    return known_plant(name)
  words = dict(word.split("=") for word in name.removeprefix(GROUND).split())
  car = Car.draw(stream(int(words.pop("car")), 0)) if "car" in words else None
  effects = tuple((effect, float(size)) for effect, size in words.items())
  return ExternalPlant(ProvingGroundPlant(car, effects).begin), np.empty(0)  # type: ignore[return-value]


def jobs(config: Config) -> list[Job]:
  """Everything, done or not, in the order in which it is best done."""
  seeds, episodes = (config.seeds[:1], 16) if config.quick else (config.seeds, config.episodes)
  own = {name: config.few if variant_named(name).twin else seeds for name in config.variants}
  trainings = [job for name in own for job in training_jobs(config.out, name, own[name], episodes)]
  plants = ["bicycle", GROUND, *(f"{GROUND} {effect}" for effect in config.effects)]
  driven = settings(2, ()) if config.quick else settings(plants=plants, special=config.special)
  return trainings + [job for name, what in driven.items() for job in driving_jobs(config.out, name, what, plant)]


def main(config: Config) -> int:
  """Do what is left, up to the limit, write the page; returns the number of jobs that are left."""
  done = 0
  while (left := [job for job in jobs(config) if not job.file.is_file()]) and done < (config.limit or done + 1):
    most = config.limit - done if config.limit else None
    batch = [job for job in left if job.name.split()[0] == left[0].name.split()[0]][:most]  # drives wait for trainings
    calls, names = [delayed(timed)(job) for job in batch], [job.name for job in batch]
    with StageLine({job.name: job.seconds for job in left[:most]}, "agents") as progress:
      for index, (wall, cpu) in staged(in_parallel(calls, config.workers, config.ray), names, progress):
        left.remove(batch[index])
        progress.say(f"{names[index]}: {wall:.0f} s, {cpu:.0f} s of CPU; {len(left)} jobs left")
    done += len(batch)
  if config.page:
    write_text(config.page, page(config.out, config.page, config.special))
  return len(left)


if __name__ == "__main__":
  run_script()
