"""Predict held-out recordings with the twin and with the bicycle model.

Writes cross_validation.json and report.html.

qcar-twin cross-validate --dataset data/sample --twin out/calibration/twin.toml --out out/cross_validation
"""

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.cross_validation.cross_validation import (
  WINDOWS,
  CrossValidation,
  cross_validate,
  find_reference,
  with_roles,
)
from calibration.cross_validation.report import verdict, write_cross_validation
from calibration.fitting.windows import Cut
from calibration.progress import CALIBRATION, CROSS_VALIDATION, StageLine, joined
from calibration.twin_calibration.calibration import calibrate
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.file import command_shift_of, load_twin
from qcar_twin.twin.twin import Twin

KEPT = "fits that were finished stay in --out, the same command goes on from them"


@dataclasses.dataclass(frozen=True)
class Config:
  """Twin against bicycle against recordings: RMSE and NRMSE by channel, for windows of 0.5 s, of 2 s and free runs."""

  dataset: Path
  """Folder with dataset.toml, in SI units."""
  out: Path
  """Folder for the results."""
  twin: Path | None = None
  """File twin.toml of a calibration; where not given, the twin is calibrated against the recordings first."""
  roles: tuple[str, ...] = ("validate",)
  """Roles of the recordings to predict; open 'holdout' once, at the end."""
  quick: bool = False
  """Windows of 2 s only, and a quick calibration where no twin is given."""
  threads: int = 0
  """Threads of the simulation; 0 uses every core. Results do not depend on it."""


def main(config: Config) -> CrossValidation:
  """Run it, write the results, print the verdict and where the report is."""
  dataset = DataSet.load(config.dataset)
  with_roles(dataset, config.roles)
  plan = joined({} if config.twin else CALIBRATION, CROSS_VALIDATION)
  with StageLine(plan) as progress:
    twin, theta, shift = _twin(config, dataset, progress)
    reference, missing = find_reference(
      dataset, Cut(most=60.0 if config.quick else 300.0, command_shift=shift), progress
    )
    windows = WINDOWS[1:2] if config.quick else WINDOWS
    result = cross_validate(dataset, twin, theta, reference, config.roles, shift, windows, missing, progress)
  report = write_cross_validation(result, config.out)
  print(verdict(result))
  print(f"report: {report}")
  return result


def _twin(config: Config, dataset: DataSet, progress: StageLine) -> tuple[Twin, NDArray[np.float64], int]:
  """Twin, its parameters, and the command timing that was fitted with it."""
  if config.twin is None:
    fitted = calibrate(dataset, "recordings", config.out, quick=config.quick, threads=config.threads, progress=progress)
    return fitted.twin, fitted.theta, fitted.command_shift
  return *load_twin(config.twin, threads=config.threads), command_shift_of(config.twin)


if __name__ == "__main__":
  run_script()
