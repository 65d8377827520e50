"""Predict recordings no fit has seen with the twin and the bicycle; writes cross_validation.json and report.html.

python scripts/cross_validate.py --dataset data/sample --twin out/calibration/twin.toml --out out/cross_validation
"""

import dataclasses
import json
import logging
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray

from calibration.calibrate import calibrate
from calibration.cross_validate import WINDOWS, CrossValidation, cross_validate, find_baseline
from calibration.progress import StageLine
from calibration.report.cross_validation import verdict
from calibration.segmenting import Cut
from qcar_twin.dataset import DataSet
from qcar_twin.twin import Twin
from qcar_twin.twin_file import load_twin


@dataclasses.dataclass(frozen=True)
class Config:
  """Twin against bicycle against recordings: RMSE and NRMSE by channel, for windows of 0.5 s, of 2 s and free runs."""

  dataset: Path
  """Folder with dataset.toml (SI units, see docs)."""
  out: Path
  """Folder for the results."""
  twin: Path | None = None
  """twin.toml of a calibration; where not given, the twin is calibrated against the recordings first."""
  roles: tuple[str, ...] = ("validate",)
  """Roles of the recordings to predict; "holdout" is meant to be opened once, at the end."""
  quick: bool = False
  """Windows of 2 s only, a quick calibration."""
  seed: int = 0
  """Of random draws; nothing here draws."""
  threads: int = 0
  """Threads of the simulation, 0 for all cores; results don't depend on it."""


def main(config: Config) -> CrossValidation:
  """Run it, write the results, print the verdict and where the report is."""
  dataset = DataSet.load(config.dataset)
  with StageLine() as progress:
    twin, theta, shift = _twin(config, dataset, progress)
    baseline, missing = find_baseline(dataset, Cut(most=60.0 if config.quick else 300.0, shift=shift), progress)
    windows = WINDOWS[1:2] if config.quick else WINDOWS
    result = cross_validate(dataset, twin, theta, baseline, config.roles, shift, windows, missing, progress)
  report = result.write(config.out)
  print(verdict(result))
  print(f"report: {report}")
  return result


def _twin(config: Config, dataset: DataSet, progress: StageLine) -> tuple[Twin, NDArray[np.float64], int]:
  """Twin, its parameters, and the command timing that was fitted with it, if the calibration beside it says so."""
  if config.twin is None:
    found = calibrate(dataset, "recordings", config.out, quick=config.quick, threads=config.threads, progress=progress)
    return found.twin, found.theta, found.shift
  beside = config.twin.with_name("calibration.json")
  shift = json.loads(beside.read_text(encoding="utf-8")).get("command_shift", 0) if beside.is_file() else 0
  return *load_twin(config.twin, threads=config.threads), int(shift)


if __name__ == "__main__":
  logging.basicConfig(level=logging.ERROR, format="%(message)s")
  try:
    main(tyro.cli(Config, description=__doc__))
  except (FileNotFoundError, ValueError) as error:
    raise SystemExit(str(error)) from error
