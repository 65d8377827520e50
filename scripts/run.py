"""Identify, calibrate, cross-validate and diagnose one data set.

Prints the verdicts and the report's path.

qcar-twin run --dataset data/sample --out out/sample
"""

import dataclasses
import functools
from pathlib import Path

from calibration.cross_validation.cross_validation import cross_validate, find_reference
from calibration.cross_validation.report import verdict as validated
from calibration.cross_validation.report import write_cross_validation
from calibration.diagnosis.curves.after_diagnosis import When, write_with_curves
from calibration.diagnosis.pipeline import diagnose, prepare
from calibration.diagnosis.report.page import verdict as diagnosed
from calibration.diagnosis.search.structure import NARROW, Effort
from calibration.diagnosis.staged import Staged
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.windows import Cut
from calibration.progress import CALIBRATION, CROSS_VALIDATION, DIAGNOSIS, StageLine, joined
from calibration.twin_calibration.calibration import QUICK, calibrate
from calibration.twin_calibration.report import verdict as calibrated
from calibration.twin_calibration.report import write_calibration
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.engines import EngineKind

KEPT = "fits that were finished stay in --out, the same command goes on from them"


@dataclasses.dataclass(frozen=True)
class Config:
  """The whole evaluation of a data set in one command."""

  dataset: Path = Path("data/sample")
  """Folder with dataset.toml, in SI units."""
  out: Path = Path("out/sample")
  """Folder for the results; each step writes a folder of its own in it."""
  quick: bool = False
  """First look: less driving in the fits and a narrower search."""
  threads: int = 0
  """Threads of the simulation; 0 uses every core. Results do not depend on it."""
  plant: EngineKind = "reduced"
  """Simulator used during the search. 'reduced' searches with the fast C model and verifies the result in MuJoCo;
  'mujoco' uses MuJoCo throughout and takes many times as long."""
  curves: When = "auto"
  """Fit free curves after the diagnosis: 'auto' fits them where a mismatch stays unexplained (docs/guide/curves.md)."""


def main(config: Config) -> Path:
  """Run all four; returns the path of the diagnosis's report."""
  dataset = DataSet.load(config.dataset)
  after = {name: seconds for name, seconds in DIAGNOSIS.items() if name != "recalibration"}  # calibration has it
  progress = StageLine(joined(CALIBRATION, CROSS_VALIDATION, after))
  begun = functools.cache(lambda: prepare(dataset, threads=config.threads, progress=progress, plant=config.plant))
  with progress:
    calibration = calibrate(
      dataset,
      "recordings",
      config.out / "calibration",
      quick=config.quick,
      threads=config.threads,
      progress=progress,
      recalibrated=lambda: begun().recalibrated,
    )
  print(calibrated(calibration))
  write_calibration(calibration, config.out / "calibration")
  with progress:
    reference, missing = find_reference(
      dataset, Cut(most=60.0 if config.quick else 300.0, command_shift=calibration.command_shift), progress
    )
    result = cross_validate(
      dataset,
      calibration.twin,
      calibration.theta,
      reference,
      ("validate",),
      calibration.command_shift,
      missing=missing,
      progress=progress,
    )
  print(validated(result))
  write_cross_validation(result, config.out / "cross_validation")
  effort = NARROW if config.quick else Effort()
  with progress:
    outcome = diagnose(
      dataset, effort=effort, threads=config.threads, progress=progress, prepared=begun(),
      staged=Staged(config.out / "diagnosis"),
    )  # fmt: skip
  print(diagnosed(outcome.diagnosis))
  most = QUICK if config.quick else LONGEST
  with progress:
    report, said = write_with_curves(
      outcome, dataset, config.out / "diagnosis", config.curves, most, config.threads, progress, config.plant
    )
  print("\n".join([*said, f"report: {report}"]))
  return report


if __name__ == "__main__":
  run_script()
