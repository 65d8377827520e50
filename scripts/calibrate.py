"""Fit the twin's parameters to a data set's car.

Writes twin.toml, calibration.json and report.html.

qcar-twin calibrate --dataset data/sample --out out/calibration --against recordings
"""

import dataclasses
from pathlib import Path
from typing import Literal

from calibration.progress import CALIBRATION, StageLine
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
  """Folder with dataset.toml, in SI units."""
  out: Path
  """Folder for the results; a stopped run with the same folder continues."""
  against: Literal["identified", "recordings"] = "identified"
  """Reference of the fit: 'identified' uses step responses of the identified bicycle, 'recordings' every recording
  with role identify."""
  add_mechanisms: tuple[str, ...] = ()
  """Ids of mechanisms that this car is known to need, which are added to the twin and fitted with it
  (docs/reference/mechanisms.md); only with --against recordings."""
  steady_state: Literal["exact", "paper"] = "exact"
  """Understeer gradient of the identification: exact, or as printed in the paper."""
  quick: bool = False
  """First look: about 40 s of driving and few iterations."""
  threads: int = 0
  """Threads of the simulation; 0 uses every core. Results do not depend on it."""
  plant: EngineKind = "reduced"
  """Simulator used during the search. 'reduced' searches with the fast C model and verifies the result in MuJoCo;
  'mujoco' uses MuJoCo throughout and takes many times as long."""


def main(config: Config) -> Calibration:
  """Run it, write the results, print the verdict and where the report is."""
  if config.add_mechanisms and config.against == "identified":
    raise ValueError("--add-mechanisms are fitted to recordings only: give --against recordings")
  dataset = DataSet.load(config.dataset)
  with StageLine(CALIBRATION) as progress:
    calibration = calibrate(
      dataset,
      config.against,
      config.out,
      config.add_mechanisms,
      config.steady_state,
      config.quick,
      config.threads,
      progress,
      plant=config.plant,
    )
  report = write_calibration(calibration, config.out)
  print(verdict(calibration))
  print(f"report: {report}")
  return calibration


if __name__ == "__main__":
  run_script()
