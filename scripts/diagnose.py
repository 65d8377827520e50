"""Diagnose a data set: where twin and recordings differ, what physics was left out, and what modelling it gains."""

import dataclasses
import logging
from pathlib import Path

import tyro
from tqdm import tqdm

from calibration.diagnosis.diagnose import diagnose, write
from calibration.diagnosis.page import verdict
from calibration.diagnosis.search import Effort
from qcar_twin.dataset import DataSet
from qcar_twin.twin_file import load_twin


@dataclasses.dataclass(frozen=True)
class Config:
  """Diagnose a data set; writes diagnosis.json, twin.toml (the repaired twin) and report.html."""

  dataset: Path
  """Folder with dataset.toml."""
  out: Path
  """Folder for the results."""
  twin: Path | None = None
  """twin.toml to go on from: its parameters are the first guess, its mechanisms are part of every model."""
  mechanisms: tuple[str, ...] = ()
  """Ids of the catalogue to consider; all of them by default."""
  quick: bool = False
  """A narrower search: fewer models are refitted."""
  threads: int = 0
  """Threads of the simulation, 0 for all cores."""


def main(config: Config) -> Path:
  """Run it; returns the path of the report."""
  dataset = DataSet.load(config.dataset)
  effort = Effort(singles=5, pairs=2, triples=1, iterations=1) if config.quick else Effort()
  with tqdm(total=100, unit="%", bar_format="{desc:<28} {bar} {elapsed}") as bar:

    def report(stage: str, share: float) -> None:
      bar.set_description_str(stage)
      bar.n = round(100 * share)
      bar.refresh()

    start = load_twin(config.twin) if config.twin else None
    outcome = diagnose(dataset, config.mechanisms or None, start, effort, threads=config.threads, report=report)
  page = write(outcome, config.out)
  print(verdict(outcome.diagnosis))
  print(f"report: {page}")
  return page


if __name__ == "__main__":
  logging.basicConfig(level=logging.WARNING, format="%(message)s")
  try:
    main(tyro.cli(Config, description=__doc__))
  except (FileNotFoundError, ValueError) as error:
    raise SystemExit(str(error)) from error
