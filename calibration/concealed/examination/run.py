"""Sitting an exam case by case: seal the truth, diagnose the data alone, keep the answer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calibration.diagnosis.decision.evidence import Evidence
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.decision.weighing import probability
from calibration.diagnosis.pipeline import diagnose
from qcar_twin.recordings.dataset import DataSet

from ..campaign.run import answer_of, attempted
from ..exam.cases import Case, make_case
from .sealed import is_answered, keep_answer, lock


def attempt(case: Case, folder: Path) -> str:
  """`sit`, whatever it raises: "" if it was answered, else a line that says what came instead.

  An error's traceback stays in `folder`/answers as NAME.error.txt until the case is answered.
  """
  return attempted(case.name, folder / "answers", lambda: sit(case, folder))


def sit(case: Case, folder: Path) -> None:
  """Make, seal, diagnose and answer one case; does nothing if its answer is there."""
  if is_answered(folder, case.name):
    return
  session, truth = make_case(case)
  lock(folder, case.name, truth)
  outcome = diagnose(DataSet(case.name, session.recordings, session.vehicle, session.vehicle_std), threads=1)
  keep_answer(folder, case.name, answer_of(outcome) | {"scored": weighed(outcome.diagnosis.evidence)})


def weighed(evidence: Evidence) -> list[dict[str, Any]]:
  """Every name of every set that was weighed, and the probability that it is right."""
  levels = usual_levels()
  return [
    {"set": list(m.mechanisms), "name": n.name, "at_bound": n.at_bound, "probability": probability(n, levels)}
    for m in evidence.models
    for n in m.names
  ]
