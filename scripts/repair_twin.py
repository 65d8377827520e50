"""Diagnose a car that conceals an effect; keep its recalibrated and its repaired twin.

qcar-twin repair-twin --out out/study --car 4501 --effect steering_delay --size 2
"""

import dataclasses
from pathlib import Path

from calibration.concealed.laboratory.seal import seal
from calibration.concealed.laboratory.written import save
from calibration.concealed.proving_ground import make_session
from calibration.diagnosis.pipeline import diagnose
from calibration.diagnosis.report.page import verdict, write_diagnosis
from calibration.diagnosis.search.structure import Effort
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.file import save_twin


@dataclasses.dataclass(frozen=True)
class Config:
  """The car, what it conceals, how long the diagnosis may look."""

  out: Path
  """folder of the study for recalibrated.toml and repaired.toml, with the session and its diagnosis below it"""
  car: int = 4501
  """seed of car, driver and noise"""
  effect: str = "steering_delay"
  """id of the concealed effect"""
  size: float = 2.0
  """in multiples of its typical magnitude"""
  design: str = "compact"
  """of the session: lab, compact or paper"""
  mechanisms: tuple[str, ...] = ()
  """ids of the catalogue to consider; all of them by default"""
  quick: bool = False
  """a narrower search: fewer models are refitted"""


def main(config: Config) -> str:
  """Make, diagnose, write; returns the verdict in a sentence."""
  session = make_session(config.car, ((config.effect, config.size),), config.design)
  mark = seal(session.truth, config.out / "session", config.out / "session_truth")
  save(session, config.out / "session", "concealed", mark)
  effort = Effort(singles=5, pairs=2, triples=1, iterations=1) if config.quick else Effort()
  outcome = diagnose(DataSet.load(config.out / "session"), config.mechanisms or None, effort=effort, threads=1)
  write_diagnosis(outcome, config.out / "diagnosis")
  save_twin(
    config.out / "recalibrated.toml", outcome.twin, outcome.before, "recalibrated to the session, nothing added"
  )
  save_twin(config.out / "repaired.toml", outcome.twin, outcome.after, "repaired by the diagnosis of the session")
  said = verdict(outcome.diagnosis)
  print(said)
  return said


if __name__ == "__main__":
  run_script()
