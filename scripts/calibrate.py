"""Calibrate the twin of a data set's car.

Writes twin.toml, calibration.json and report.html.

qcar-twin calibrate --dataset data/sample --out out/calibration --against recordings
"""

import dataclasses
from pathlib import Path
from typing import Literal

from calibration.progress import StageLine
from calibration.twin_calibration.calibration import Calibration, calibrate
from calibration.twin_calibration.report import verdict, write_calibration
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.engines import EngineKind

KEPT = "fits that were finished stay in --out, the same command goes on from them"


@dataclasses.dataclass(frozen=True)
class Config:
  """Fit the twin to the identified bicycle's step responses, or to the recordings themselves."""

  dataset: Path
  """Folder with dataset.toml (SI units, see docs)."""
  out: Path
  """Folder for the results; a broken-off run with the same folder goes on where it was."""
  against: Literal["identified", "recordings"] = "identified"
  """identified: step responses of the paper's bicycle; recordings: everything with role "identify"."""
  mechanism: tuple[str, ...] = ()
  """Ids of the catalogue this car is known to need (docs/reference/mechanisms.md); against recordings only."""
  steady_state: Literal["exact", "paper"] = "exact"
  """Understeer gradient of the identification: exact, or as printed in the paper."""
  quick: bool = False
  """About 40 s of driving and few iterations: a first look."""
  seed: int = 0
  """Of random draws; kept with the results. The fits draw nothing, so they don't depend on it."""
  threads: int = 0
  """Threads of the simulation, 0 for all cores; results don't depend on it."""
  plant: EngineKind = "reduced"
  """What is searched with: the reduced car, confirmed by MuJoCo, or "mujoco" alone: many times as long."""


def main(config: Config) -> Calibration:
  """Run it, write the results, print the verdict and where the report is."""
  dataset = DataSet.load(config.dataset)
  with StageLine() as progress:
    found = calibrate(
      dataset,
      config.against,
      config.out,
      config.mechanism,
      config.steady_state,
      config.quick,
      config.threads,
      progress,
      plant=config.plant,
    )
  report = write_calibration(found, config.out)
  print(verdict(found))
  print(f"report: {report}")
  return found


if __name__ == "__main__":
  run_script()
