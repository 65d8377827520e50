"""Campaigns on the proving ground: many sessions with concealed effects, diagnosed blind and scored.

A case is made from its seed, diagnosed without sight of its truth, and its answer is written with its
hash before the truth is looked at. A campaign that is stopped goes on where it was.
"""

import dataclasses
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from calibration.concealed.campaign.archive import digest, keep
from calibration.concealed.campaign.cases import Case
from calibration.concealed.campaign.reference import baselines, oracle
from calibration.concealed.campaign.wild_score import informed
from calibration.concealed.laboratory.written import stream
from calibration.concealed.proving_ground import Car, ProvingGroundPlant, make_session
from calibration.concealed.second_car import make_second_session
from calibration.concealed.second_car.plant import SecondCarPlant
from calibration.concealed.second_car.session import drawn_car
from calibration.diagnosis.curves.study import study
from calibration.diagnosis.decision.evidence import as_json
from calibration.diagnosis.outcome import Outcome
from calibration.diagnosis.pipeline import diagnose
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.report.demonstration import NOTHING_SHOWN
from calibration.diagnosis.report.document import document
from calibration.diagnosis.report.page import verdict, write_diagnosis
from calibration.diagnosis.score import compare
from calibration.diagnosis.search.structure import Effort
from qcar_twin.atomic_io import plain, write_text
from qcar_twin.recordings.dataset import DataSet

MAKERS = {"first": make_session, "second": make_second_session}
ENGINES = ("search", "curves")
VERDICT = "verdict.txt"
LONGEST = 120.0  # s that the second car is driven at most


class CaseFailed(RuntimeError):
  """Cases without an answer, because making one ended in an error."""


def attempt(case: Case, folder: Path, engine: str = "search") -> str:
  """`run_case`, whatever it raises: "" if it was answered, else a line that says what came instead."""
  return attempted(case.name, folder, lambda: run_case(case, folder, engine=engine))


def attempted(name: str, folder: Path, answer: Callable[[], object]) -> str:
  """Call, whatever it raises: "" if it did not, else a line that says what came instead.

  An error's traceback stays in `folder` as NAME.error.txt until the case is answered.
  """
  story = folder / f"{name}.error.txt"
  try:
    answer()
  except Exception as error:  # one case that cannot be answered must not cost the others theirs
    write_text(story, traceback.format_exc())
    return f"{name} ({type(error).__name__}: {error})"
  story.unlink(missing_ok=True)
  return ""


def all_answered(said: Sequence[str], folder: Path) -> None:
  """Raises CaseFailed if one of the lines of `attempt` says that there is no answer."""
  failed = sorted(line for line in said if line)
  if failed:
    count = "1 case has" if len(failed) == 1 else f"{len(failed)} cases have"
    raise CaseFailed(
      f"{count} no answer: {'; '.join(failed)}. The others are scored; {folder}/*.error.txt say where it arose, and the"
      " same command tries again"
    )


def run_case(case: Case, folder: Path, threads: int = 1, engine: str = "search") -> Path:
  """Make, diagnose and answer one case; does nothing if its answer is there.

  Args:
    engine: "search" for `diagnose`, "curves" for `study`, which leaves no pool that reference methods could be
      taken from.

  Raises:
    ValueError: there is no such engine.
  """
  if engine not in ENGINES:
    raise ValueError(f"engine must be one of {', '.join(ENGINES)}, not '{engine}'")
  path = folder / f"{case.name}.json"
  if path.is_file():
    return path
  session = MAKERS[case.car](case.seed, case.effects, case.design, case.noise)
  dataset = DataSet(case.name, session.recordings, session.vehicle, session.vehicle_std)
  if engine == "curves":
    return _kept(
      case, study(dataset, threads=threads).document(), session.truth, path, informed(dataset, case, threads)
    )
  outcome = diagnose(dataset, threads=threads)
  answer = answer_of(outcome)
  sealed = digest(answer)
  # the truth joins the file only after the answer and its hash stand
  truth, holdout = session.truth["effects"], dataset.role("holdout")
  result = {"case": dataclasses.asdict(case), "answer": answer, "sha256": sealed, "truth": truth}
  result |= {"baselines": baselines(outcome, holdout), "oracle": oracle(outcome, [t["id"] for t in truth], holdout)}
  folder.mkdir(parents=True, exist_ok=True)
  keep(result, path)
  return path


def _kept(case: Case, answer: dict, truth: dict, path: Path, oracle: dict | None = None) -> Path:
  """An answer and its hash; truth and oracle join the file only after them."""
  answer = plain(answer)
  result = {"case": dataclasses.asdict(case), "answer": answer, "sha256": digest(answer), "truth": truth["effects"]}
  result |= {"sensors": truth.get("sensors")} | ({"oracle": oracle} if oracle else {})
  path.parent.mkdir(parents=True, exist_ok=True)
  keep(plain(result), path)
  return path


def diagnosed(case: Case, folder: Path, effort: Effort, threads: int = 1) -> None:
  """Diagnose a case's session into a folder, as `qcar-twin diagnose` does, unless that was done."""
  if not (folder / VERDICT).is_file():
    session = MAKERS[case.car](case.seed, case.effects, case.design, case.noise)
    dataset = DataSet(case.name, session.recordings, session.vehicle, session.vehicle_std)
    outcome = diagnose(dataset, effort=effort, threads=threads)
    write_diagnosis(outcome, folder, NOTHING_SHOWN)
    write_text(folder / VERDICT, verdict(outcome.diagnosis) + "\n")


def drivable(case: Case, effect: bool = True) -> ProvingGroundPlant | SecondCarPlant:
  """The car of a case, with its effect or without, for a controller to drive."""
  effects = case.effects if effect else ()
  if case.car == "second":
    return SecondCarPlant(drawn_car(case.seed), effects, seconds=LONGEST)
  return ProvingGroundPlant(Car.draw(stream(case.seed, 0)), effects)


def answer_of(outcome: Outcome) -> dict:
  """What the diagnosis says, and the figures that thresholds are held against."""
  diagnosis = outcome.diagnosis
  full = document(diagnosis)
  keep = ("verdict", "claims", "departures", "where", "untestable", "fit", "seconds", "unknown")
  out = {key: full[key] for key in keep} | {"ranking": full["ranking"][:12]}
  out["stages"] = dict(diagnosis.stages)
  out["evidence"] = as_json(diagnosis.evidence)
  out["trials"] = _trials(diagnosis.pool)
  return out


def _trials(pool: Pool) -> list[dict]:
  """Every set that was fitted, with its figures: what thresholds are held against."""
  rows = []
  for key, model in pool.models.items():
    if not key:
      continue
    sizes = {
      p.name: [*model.estimate(p.name), p.typical or p.scale]
      for name in key
      for p in pool.problem.mechanism(name).parameters
      if p.null is not None
    }
    test = compare(model, pool.base, pool.problem.observations)
    figures_of = {"t": test.t, "gain": test.gain, "share": test.share_positive, "total": test.total}
    row = {"set": sorted(key), "cost": pool.base.cost - model.cost, "sizes": sizes, "relative": test.relative}
    rows.append(row | figures_of)
  return sorted(rows, key=lambda r: -r["total"])
