"""The diagnosis from end to end: a data set in, a verdict, a repaired twin and a report out."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate, candidate, refine
from calibration.diagnosis.decide import Decision, Thresholds, decide
from calibration.diagnosis.detect import detect
from calibration.diagnosis.locate import locate
from calibration.diagnosis.output import Diagnosis, write_outputs
from calibration.diagnosis.recalibrate import BIAS_MECHANISMS, Baseline, recalibrate, sensor_floor, with_sensor_biases
from calibration.diagnosis.scan import scan
from calibration.diagnosis.score import compare_freely
from calibration.diagnosis.search import Effort, Pool, base_candidate, search
from calibration.diagnosis.ship import compare_twins
from calibration.diagnosis.unknown import smooth_forces, unknown_sensors
from calibration.first_guess import first_guess
from calibration.segmenting import Cut
from qcar_twin.dataset import DataSet
from qcar_twin.mechanisms import catalogue, select
from qcar_twin.mechanisms.base import Mechanism
from qcar_twin.recording import Recording
from qcar_twin.twin import Twin
from qcar_twin.twin_file import save_twin
from qcar_twin.vehicle import Vehicle

Array = NDArray[np.float64]
Report = Callable[[str, float], None]  # stage, share of it that is done
LONGEST = 420.0  # s of driving that are simulated; longer data sets are sampled evenly
SHIFTS = (-1, 0, 1)  # control periods, where the log's timing convention is unknown


@dataclasses.dataclass(frozen=True)
class Outcome:
  """A diagnosis with the twin it repaired.

  Attributes:
    diagnosis: verdict, location, fits.
    twin: the car with the whole catalogue.
    before, after: parameter vectors of the recalibrated and the repaired twin, (P,).
  """

  diagnosis: Diagnosis
  twin: Twin
  before: Array
  after: Array


def diagnose(
  dataset: DataSet,
  mechanisms: Sequence[str] | None = None,
  effort: Effort = Effort(),  # noqa: B008 - frozen
  thresholds: Thresholds = Thresholds(),  # noqa: B008
  substeps: int = 2,
  threads: int = 0,
  report: Report = lambda stage, share: None,
) -> Outcome:
  """Find out what physics a data set shows that the twin lacks.

  Args:
    dataset: recordings with roles; "identify" is fitted, "validate" judges, "holdout" is opened at the end.
    mechanisms: ids to consider; the whole catalogue by default.
    effort: how wide to search.
    thresholds: what a claim needs.
    substeps: simulation steps per control period of 10 ms.
    threads: of the simulation, 0 for all cores.
    report: told the stage and how much of it is done.
  """
  clock = _Clock(report)
  known: tuple[Mechanism, ...] = tuple(catalogue().values()) if mechanisms is None else select(mechanisms)
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  twin = Twin(vehicle, [*known, *smooth_forces()], substeps=substeps, threads=threads)
  recordings = [r for r in dataset.recordings if r.role != "holdout"]
  clock.start("recalibration")
  priors = with_sensor_biases(first_guess(recordings, vehicle), twin)
  baseline = recalibrate(twin, recordings, priors, _shifts(dataset), Cut(most=LONGEST))
  base = base_candidate(baseline)
  clock.start("scan")
  candidates = [m for m in known if m.name not in BIAS_MECHANISMS]
  signatures = scan(baseline.problem, base, candidates, progress=lambda done, total: report("scan", done / total))
  clock.start("search")
  pool = search(baseline, base, signatures, effort, lambda text: report(text, 0.0))
  clock.start("unknown")
  unknowns = fit_unknowns(pool)
  clock.start("decision")
  decision = decide(pool, unknowns, thresholds)
  clock.start("detection and location")
  detection = detect(baseline, pool.base, problem=pool.problem)
  location = _located(pool, decision, unknowns)
  clock.start("hold-out")
  fits = {
    role: _compared(twin, baseline, pool, decision, [r for r in dataset.recordings if r.role == role])
    for role in ("validate", "holdout")
  }
  clock.stop()
  diagnosis = Diagnosis(
    dataset=dataset.name,
    decision=decision,
    detection=detection,
    location=location,
    pool=pool,
    validate=fits["validate"],
    holdout=fits["holdout"],
    seconds=sum(clock.stages.values()),
    stages=clock.stages,
    notes=dataset.warnings,
  )
  return Outcome(diagnosis, twin, pool.base.theta, decision.model.theta)


def write(outcome: Outcome, folder: str | Path) -> Path:
  """Write diagnosis.json, report.html and twin.toml (the repaired twin); returns the report's path."""
  claims = ", ".join(c.mechanism for c in outcome.diagnosis.decision.claims) or "no mechanism added"
  save_twin(
    Path(folder) / "twin.toml", outcome.twin, outcome.after, f"repaired on {outcome.diagnosis.dataset}: {claims}"
  )
  return write_outputs(folder, outcome.diagnosis)


def fit_unknowns(pool: Pool) -> dict[str, Candidate]:
  """The UNKNOWN rivals, fitted with the pool's weights."""
  made = [candidate(pool.problem, (force.name,), pool.base, pool.priors) for force in smooth_forces()]
  for item in made:
    item.residual = pool.base.residual.copy()
  refine(pool.problem, made, 1)
  observations = pool.problem.observations
  prediction = pool.problem.predict(pool.base.theta[None])
  whitening = pool.problem.whiten(np.ones(len(observations)))
  return {m.mechanisms[0]: m for m in made} | unknown_sensors(pool.base, observations, prediction, whitening)


def _located(pool: Pool, decision: Decision, unknowns: dict[str, Candidate]):
  gains = {name: compare_freely(m, pool.base, pool.problem.observations).gain for name, m in unknowns.items()}
  rests_on_unknown = decision.verdict == "unexplained" and decision.unknown is not None
  rival = unknowns[decision.unknown[0]] if rests_on_unknown and decision.unknown else None
  return locate(pool, decision.model, gains, rival, claimed=[c.mechanism for c in decision.claims])


def _compared(twin: Twin, baseline: Baseline, pool: Pool, decision: Decision, recordings: list[Recording]):
  cut = Cut(shift=baseline.shift, most=LONGEST)
  floor = sensor_floor(baseline.passport)
  return compare_twins(twin, pool.base.theta, decision.model.theta, recordings, floor, cut)[0]


def _shifts(dataset: DataSet) -> tuple[int, ...]:
  return SHIFTS if dataset.command_timing == "unknown" else (0,)


class _Clock:
  """Wall time per stage."""

  def __init__(self, report: Report):
    self._report, self._name, self._since = report, "", 0.0
    self.stages: dict[str, float] = {}

  def start(self, name: str) -> None:
    self.stop()
    self._name, self._since = name, time.perf_counter()
    self._report(name, 0.0)

  def stop(self) -> None:
    if self._name:
      self.stages[self._name] = time.perf_counter() - self._since
      self._name = ""
