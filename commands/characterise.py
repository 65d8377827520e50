"""Give the twin free curves for its maps, fit them, and say which forms they have.

Writes twin.toml (the better of the two on recordings that only judge), characterise.json and report.html.

qcar-twin characterise --dataset data/sample --out out/characterised
"""

import dataclasses
from pathlib import Path

from calibration.characterise.page import write_study
from calibration.characterise.study import Study, sentences, study
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.progress import StageLine
from qcar_twin.atomic_io import write_json
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.file import save_twin


@dataclasses.dataclass(frozen=True)
class Config:
  """Free curves for drive, resistance and steering, beside lags, sensor ages and trims, against four references."""

  dataset: Path
  """Folder with dataset.toml (SI units, see docs)."""
  out: Path = Path("out/characterised")
  """Folder for the results."""
  most: float = LONGEST
  """Driving that is simulated, s."""
  threads: int = 0
  """Threads of the simulation, 0 for all cores; results don't depend on it."""
  plant: EngineKind = "reduced"
  """What is fitted on: the reduced car, or "mujoco", many times as long; errors are MuJoCo's either way."""


def main(config: Config) -> Study:
  """Run it, write the results, print what was found."""
  dataset = DataSet.load(config.dataset)
  with StageLine() as progress:
    found = study(dataset, config.most, config.threads, progress, config.plant)
  note = f"characterised on {found.dataset}: curves of no known form; sessions' own trims are left out"
  save_twin(config.out / "twin.toml", *found.shipped, note)
  write_json(config.out / "characterise.json", found.document())
  for line in sentences(found):
    print(line)
  which = found.best.replace("_", " ")
  print(f"twin, the best of four by validation, {which}: {config.out / 'twin.toml'}")
  print(f"report: {write_study(found, config.out)}")
  return found
