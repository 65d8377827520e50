"""Diagnose a car with a concealed effect, and keep its recalibrated and repaired twins.

qcar-twin repair-twin --out out/study --car 4501 --effect steering_delay --size 2
"""

import dataclasses
from pathlib import Path

from calibration.concealed.laboratory.seal import seal
from calibration.concealed.laboratory.written import save
from calibration.concealed.proving_ground import make_session
from calibration.diagnosis.pipeline import diagnose
from calibration.diagnosis.report.page import verdict, write_diagnosis
from calibration.diagnosis.search.structure import NARROW, Effort
from calibration.progress import DIAGNOSIS, StageLine
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.file import save_twin


@dataclasses.dataclass(frozen=True)
class Config:
  """The car, its concealed effect, and the width of the search."""

  out: Path
  """Folder for recalibrated.toml and repaired.toml, with the session and its diagnosis in it."""
  car: int = 4501
  """Seed of car, driver and noise."""
  effect: str = "steering_delay"
  """Id of the concealed effect."""
  size: float = 2.0
  """Size of the effect in multiples of its typical magnitude."""
  design: str = "compact"
  """Session design: lab, compact or paper."""
  candidates: tuple[str, ...] = ()
  """Ids of the only mechanisms that may be named; the whole catalogue where not given."""
  quick: bool = False
  """Narrower search: fewer models are refitted."""


def main(config: Config) -> str:
  """Make, diagnose, write; returns the verdict in a sentence."""
  session = make_session(config.car, ((config.effect, config.size),), config.design)
  mark = seal(session.truth, config.out / "session", config.out / "session_truth")
  save(session, config.out / "session", "concealed", mark)
  effort = NARROW if config.quick else Effort()
  dataset = DataSet.load(config.out / "session")
  with StageLine(DIAGNOSIS) as progress:
    outcome = diagnose(dataset, config.candidates or None, effort=effort, threads=1, progress=progress)
  write_diagnosis(outcome, config.out / "diagnosis")
  notes = {"recalibrated": "recalibrated to the session, nothing added",
           "repaired": "repaired by the diagnosis of the session"}  # fmt: skip
  for name, theta in (("recalibrated", outcome.before), ("repaired", outcome.after)):
    save_twin(config.out / f"{name}.toml", outcome.twin, theta, notes[name], outcome.cut.command_shift)
  said = verdict(outcome.diagnosis)
  print(said)
  return said


if __name__ == "__main__":
  run_script()
