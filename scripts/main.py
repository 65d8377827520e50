"""The main job on one data set: identify, calibrate, cross-validate, diagnose; prints verdict and report's path.

python scripts/main.py --dataset data/sample --out out/sample
"""

import dataclasses
import logging
from pathlib import Path

import tyro

from calibration.calibrate import calibrate
from calibration.cross_validate import cross_validate, find_baseline
from calibration.diagnosis.diagnose import diagnose, write
from calibration.diagnosis.page import verdict as diagnosed
from calibration.diagnosis.search import Effort
from calibration.longitudinal import NotIdentifiable
from calibration.progress import StageLine
from calibration.report.calibration import verdict as calibrated
from calibration.report.cross_validation import verdict as validated
from calibration.segmenting import Cut
from qcar_twin.dataset import DataSet


@dataclasses.dataclass(frozen=True)
class Config:
  """Everything the project is for, in one command; every step writes a folder of its own below `out`."""

  dataset: Path = Path("data/sample")
  """Folder with dataset.toml (SI units)."""
  out: Path = Path("out/sample")
  """Folder for the results."""
  quick: bool = False
  """A first look: less driving in the fits, a narrower search."""
  seed: int = 0
  """Of random draws; kept with the results. The fits draw nothing."""
  threads: int = 0
  """Threads of the simulation, 0 for all cores."""


def main(config: Config) -> Path:
  """Run all four; returns the path of the diagnosis's report."""
  dataset = DataSet.load(config.dataset)
  with StageLine() as progress:
    found = calibrate(
      dataset, "recordings", config.out / "calibration", quick=config.quick, threads=config.threads, progress=progress
    )
  print(calibrated(found))
  found.write(config.out / "calibration")
  with StageLine() as progress:
    baseline, missing = find_baseline(dataset, Cut(most=60.0 if config.quick else 300.0, shift=found.shift), progress)
    result = cross_validate(
      dataset, found.twin, found.theta, baseline, ("validate",), found.shift, missing=missing, progress=progress
    )
  print(validated(result))
  result.write(config.out / "cross_validation")
  effort = Effort(singles=5, pairs=2, triples=1, iterations=1) if config.quick else Effort()
  with StageLine() as progress:
    outcome = diagnose(dataset, effort=effort, threads=config.threads, report=lambda stage, share: progress(stage))
  report = write(outcome, config.out / "diagnosis")
  print(diagnosed(outcome.diagnosis))
  print(f"report: {report}")
  return report


if __name__ == "__main__":
  logging.basicConfig(level=logging.ERROR, format="%(message)s")
  try:
    main(tyro.cli(Config, description=__doc__))
  except (NotIdentifiable, FileNotFoundError, ValueError) as error:
    raise SystemExit(str(error)) from error
