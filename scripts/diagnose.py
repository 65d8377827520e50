"""Find where twin and recordings differ, and which missing physics explains it.

Writes diagnosis.json, twin.toml (the repaired twin, or the one with free curves where that is better) and report.html.

qcar-twin diagnose --dataset data/sample --out out/diagnosed
"""

import dataclasses
from pathlib import Path

from calibration.diagnosis.curves.after_diagnosis import When, write_with_curves
from calibration.diagnosis.pipeline import diagnose
from calibration.diagnosis.report.page import verdict
from calibration.diagnosis.search.structure import NARROW, Effort
from calibration.diagnosis.staged import Staged
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.progress import DIAGNOSIS, StageLine
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.file import load_twin

KEPT = "where staged/recalibrated.toml was written by then, --twin with it goes on from there"


@dataclasses.dataclass(frozen=True)
class Config:
  """Diagnose a data set; writes diagnosis.json, twin.toml (the repaired twin) and report.html."""

  dataset: Path
  """Folder with dataset.toml, in SI units."""
  out: Path
  """Folder for the results."""
  twin: Path | None = None
  """File twin.toml to start from: its parameters are the first guess and every model keeps its mechanisms."""
  candidates: tuple[str, ...] = ()
  """Ids of the only mechanisms that may be named; all where not given (docs/reference/mechanisms.md)."""
  quick: bool = False
  """Narrower search: fewer models are refitted, no formula is sought, and curves are fitted to a quarter of the
  driving."""
  threads: int = 0
  """Threads of the simulation; 0 uses every core. Results do not depend on it."""
  plant: EngineKind = "reduced"
  """Simulator used during the search. 'reduced' searches with the fast C model and verifies the result in MuJoCo;
  'mujoco' uses MuJoCo throughout and takes many times as long."""
  curves: When = "auto"
  """Fit free curves after the diagnosis: 'auto' fits them where a mismatch stays unexplained (docs/guide/curves.md)."""


def main(config: Config) -> Path:
  """Run it; returns the path of the report."""
  dataset = DataSet.load(config.dataset)
  effort = NARROW if config.quick else Effort()
  start = load_twin(config.twin) if config.twin else None
  progress = StageLine(DIAGNOSIS)
  with progress:
    outcome = diagnose(
      dataset, config.candidates or None, start, effort, threads=config.threads, progress=progress, plant=config.plant,
      staged=Staged(config.out),
    )  # fmt: skip
  print(verdict(outcome.diagnosis))
  most = LONGEST / 4.0 if config.quick else LONGEST
  with progress:
    page, said = write_with_curves(
      outcome, dataset, config.out, config.curves, most, config.threads, progress, config.plant
    )
  print("\n".join([*said, f"report: {page}"]))
  return page


if __name__ == "__main__":
  run_script()
