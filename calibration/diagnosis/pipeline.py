"""The diagnosis from end to end: a data set in, a verdict, a repaired twin and a report out."""

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from calibration.diagnosis.candidates import Candidate, candidate, refine, simulate
from calibration.diagnosis.considered import always_free, considered
from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.conclude import above_level, conclude, judged
from calibration.diagnosis.decision.decide import Decision, decide
from calibration.diagnosis.decision.evidence import Evidence
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.experiment import next_experiment
from calibration.diagnosis.formula.after import formula_left
from calibration.diagnosis.formula.looking import STAGE
from calibration.diagnosis.holdout_errors import ChannelFit, Replay, compare_twins, ratios
from calibration.diagnosis.locate import Location, locate
from calibration.diagnosis.outcome import Diagnosis, Outcome
from calibration.diagnosis.pool import Pool, base_candidate
from calibration.diagnosis.scan import scan
from calibration.diagnosis.score import compare_freely
from calibration.diagnosis.search.gather import errors_left, gather, what_is_left, with_errors
from calibration.diagnosis.search.structure import Effort, search
from calibration.diagnosis.staged import NOWHERE, Staged
from calibration.diagnosis.unexplained.unknown import smooth_forces, unknown_sensors
from calibration.fitting.dataset_recalibration import LONGEST, Start, recalibrate_dataset
from calibration.fitting.noise_floor import driving_noise, residual_floor
from calibration.fitting.recalibration import RecalibratedTwin, recalibrate_from
from calibration.fitting.surrogate import Surrogate, exact, searching
from calibration.fitting.tolerances import rather, stopped, unusual, without_channel
from calibration.fitting.windows import Cut
from calibration.log_check.ready import fitted_ages, ready
from calibration.progress import Progress, silent
from qcar_twin.plant import SUBSTEPS
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class Prepared:
  """A data set with the twin recalibrated on it, before anything is searched.

  Attributes:
    dataset: with the roles that are used, see `with_coverage`; notes: sensors that disagree, roles that were changed.
    known: mechanisms of the twin, all at their null.
    recalibrated: the twin.
  """

  dataset: DataSet
  notes: tuple[str, ...]
  known: tuple[Mechanism, ...]
  recalibrated: RecalibratedTwin


def prepare(
  dataset: DataSet,
  candidates: Sequence[str] | None = None,
  start: Start | None = None,
  substeps: int = SUBSTEPS,
  threads: int = 0,
  progress: Progress = silent,
  plant: EngineKind = "reduced",
) -> Prepared:
  """Recalibrate the twin that a diagnosis starts from; arguments as for `diagnose`."""
  dataset, notes = ready(dataset)
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  known = considered(candidates, start, vehicle.drive)
  twin = Twin(vehicle, [*known, *smooth_forces()], substeps=substeps, threads=threads)
  searched, said = searching(twin, plant)
  ages = fitted_ages(dataset, vehicle)
  recalibrated = recalibrate_dataset(dataset, searched, start, progress=progress, ages=ages)
  if isinstance(found := recalibrated.problem.twin, Surrogate) and found.guarded:
    where = ", ".join(f"{name} from {offset:.4g} s" for name, offset in sorted(found.guarded))
    said += (f"simulated by MuJoCo during the search, too: {where}; there the reduced car leads a fit astray",)
  fit = recalibrated.fit
  told = (
    unusual(fit.parameters, fit.theta),
    rather(fit.parameters, fit.theta),
    stopped(fit.parameters, fit.theta, fit.at_bound),
  )
  return Prepared(dataset, notes + said + tuple(filter(None, told)), known, recalibrated)


def diagnose(
  dataset: DataSet,
  candidates: Sequence[str] | None = None,
  start: Start | None = None,
  effort: Effort = Effort(),
  substeps: int = SUBSTEPS,
  threads: int = 0,
  progress: Progress = silent,
  prepared: Prepared | None = None,
  plant: EngineKind = "reduced",
  staged: Staged = NOWHERE,
) -> Outcome:
  """Find out what physics a data set shows that the twin lacks.

  Args:
    dataset: recordings with roles; "identify" is fitted, "validate" judges (but see coverage.py), "holdout" is opened
      at the end.
    candidates: ids of the only mechanisms that may be named; the whole catalogue by default.
    start: a twin to go on from, with its parameters: they are the first guess, and its mechanisms are in every model.
    effort: how wide to search.
    substeps: simulation steps per control period of 10 ms.
    threads: of the simulation, 0 for all cores.
    progress: reports the stage and how much of it is done.
    prepared: of `prepare` with the same data set, candidates and start, where it was done before.
    plant: what is searched with: the reduced car, as far as it can stand in for MuJoCo's, or "mujoco" alone. What is
      claimed is MuJoCo's either way.
    staged: where what is ready is written while the rest runs.
  """
  clock = _Clock(progress)
  clock.start("recalibration")
  begun = prepared or prepare(dataset, candidates, start, substeps, threads, plant=plant)
  twin = exact(begun.recalibrated.problem.twin)
  priors = begun.recalibrated.fit.parameters
  asked = [m for m in begun.known if (candidates is None or m.name in candidates) and not always_free(m, priors)]
  tried = [m for m in asked if not without_channel(m, dataset.recordings)]
  noise = residual_floor(driving_noise([r for r in dataset.recordings if r.role != "holdout"]))
  baseline, pool = _searched(begun.recalibrated, tried, effort, clock, staged, noise)
  cut = Cut(command_shift=baseline.command_shift, most=LONGEST)
  diagnosis = _judged(begun, twin, pool, cut, clock, staged)
  outcome = Outcome(diagnosis, twin, pool.base.theta, diagnosis.model.theta, cut)
  if effort.formula and diagnosis.decision.nameless:
    staged.concluded(outcome)
    clock.start(STAGE)
    formula = formula_left(pool, diagnosis.decision, begun.dataset.role("holdout"), cut, clock.progress)
    done = {"formula": formula, "seconds": clock.stop(), "stages": clock.stages}
    outcome = dataclasses.replace(outcome, diagnosis=dataclasses.replace(diagnosis, **done))
  return outcome


def _judged(begun: Prepared, twin: Twin, pool: Pool, cut: Cut, clock: "_Clock", staged: Staged) -> Diagnosis:
  """What is said of a pool: names, what is left, where it shows; hold-out recordings are opened for what is named."""
  clock.start("decision")
  dataset, evidence = begun.dataset, gather(pool, begun.dataset.name)
  staged.weighed(evidence, decide(evidence))
  errors = functools.cache(lambda mechanisms, role: _before_and_after(twin, pool, mechanisms, dataset.role(role), cut))
  named, evidence = _named(evidence, lambda model: ratios(errors(model, "holdout")[1]))
  validate, judging = errors(named.mechanisms, "validate")
  decision, unknowns, evidence = _concluded(named, pool, evidence, lambda model: errors(model, "validate")[0])
  clock.start("location")
  place, experiment = _located(pool, decision, unknowns), next_experiment(pool, decision)
  clock.start("hold-out")
  holdout, unseen = errors(decision.mechanisms, "holdout")
  return Diagnosis(
    dataset=dataset.name,
    decision=decision,
    location=place,
    pool=pool,
    evidence=with_errors(evidence, {"validate": validate, "holdout": holdout}),
    validate=validate,
    holdout=holdout,
    replay=unseen or judging,
    seconds=clock.stop(),
    stages=clock.stages,
    next_experiment=experiment,
    notes=dataset.notices + begun.notes,
  )


Unknowns = Mapping[str, tuple[Candidate, Comparison]]  # fitted, with what each gains over the recalibrated twin


def fit_unknowns(pool: Pool) -> Unknowns:
  """The UNKNOWN rivals, fitted with the pool's weights: forces, which are simulated, and errors of the sensors."""
  near = pool.problem.at(pool.base.theta)
  made = [candidate(near, (force.name,), pool.base, pool.priors) for force in smooth_forces()]
  for item in made:
    item.residual = pool.base.residual.copy()
  refine(near, made, 1)
  simulate(near.exact, made)
  observations = pool.problem.observations
  prediction = pool.problem.exact.predict(pool.base.theta[None])
  whitening = pool.problem.whiten(np.ones(len(observations)))
  fitted = {m.mechanisms[0]: m for m in made} | unknown_sensors(pool.base, observations, prediction, whitening)
  return {name: (model, compare_freely(model, pool.base, observations)) for name, model in fitted.items()}


def _searched(
  baseline: RecalibratedTwin, tried: Sequence[Mechanism], effort: Effort, clock: "_Clock", staged: Staged,
  noise: Mapping[str, float],
) -> tuple[RecalibratedTwin, Pool]:  # fmt: skip
  """Scan and search; once more from a lower minimum of the recalibrated twin where a larger model led to one.

  Where wheels slide the cost has many minima. A mechanism whose fit leaves a wrong one is credited with all that lies
  between the two, unless the recalibrated twin is taken there as well.
  """
  earlier: list[Candidate] = []
  while True:
    base = base_candidate(baseline)
    staged.base(exact(baseline.problem.twin), base.theta, baseline.command_shift)
    clock.start("scan")
    signatures = scan(baseline.problem, base, tried, progress=clock.progress, noise=noise)
    staged.scanned(signatures)
    clock.start("search")
    pool = search(baseline, base, signatures, effort, clock.progress, earlier)
    if earlier or not pool.base_not_converged:
      return baseline, pool
    earlier = [pool.best(list(pool.models.values()))]
    clock.start("recalibration")
    baseline = recalibrate_from(baseline, pool.base.theta)


def _named(evidence: Evidence, opening: Callable[[tuple[str, ...]], Mapping[str, float]]) -> tuple[Decision, Evidence]:
  """The decision once held-out recordings were opened for the set that is named, and for what is named where that
  falls; `opening`: what the names of a set do to the errors there."""
  named = decide(evidence)
  while named.mechanisms and not evidence.is_open(named.mechanisms):
    evidence = evidence.with_opened(named.mechanisms, opening(named.mechanisms))
    named = decide(evidence)
  return named, evidence


def _concluded(
  named: Decision, pool: Pool, evidence: Evidence, judging: Callable[[tuple[str, ...]], Mapping[str, ChannelFit]]
) -> tuple[Decision, Unknowns, Evidence]:
  """The verdict; UNKNOWN rivals that say where what is left could act, none where nothing is; what is left.

  `judging`: errors of the recalibrated twin and of one with some mechanisms on recordings that only judge.
  """
  levels = usual_levels()
  evidence = evidence.with_left((), [*what_is_left(pool, ()), *errors_left(judging(named.mechanisms), pool)[0]])
  model = judged(named, evidence, levels)
  if model:
    evidence = evidence.with_left(model, [*what_is_left(pool, model), *errors_left(judging(model), pool)[1]])
  unknowns = fit_unknowns(pool) if above_level(evidence.left(model) or (), levels) else {}
  best = max(((name, test) for name, (_, test) in unknowns.items()), key=lambda found: found[1].gain, default=None)
  return conclude(named, evidence, levels, best), unknowns, evidence


def _located(pool: Pool, decision: Decision, unknowns: Unknowns) -> Location:
  gains = {name: test.gain for name, (_, test) in unknowns.items()}
  rival = unknowns[decision.unknown[0]][0] if decision.verdict == "unexplained" and decision.unknown else None
  return locate(pool, pool.model(decision.mechanisms), gains, rival, claimed=[c.mechanism for c in decision.claims])


def _before_and_after(
  twin: Twin, pool: Pool, mechanisms: Sequence[str], recordings: Sequence[Recording], cut: Cut
) -> tuple[dict[str, ChannelFit], Replay | None]:
  model, key = pool.model(mechanisms), frozenset(mechanisms)
  without = {name: pool.models[key - {name}].theta for name in model.mechanisms if key - {name} in pool.models}
  return compare_twins(twin, pool.base.theta, model.theta, recordings, pool.floor, cut, without=without)


class _Clock:
  """Wall time per stage."""

  def __init__(self, progress: Progress):
    self.progress, self._name, self._since = progress, "", 0.0
    self.stages: dict[str, float] = {}

  def start(self, name: str) -> None:
    self.stop()
    self._name, self._since = name, time.perf_counter()
    self.progress(name)

  def stop(self) -> float:
    """Seconds of all stages so far."""
    if self._name:
      spent = time.perf_counter() - self._since
      self.stages[self._name] = self.stages.get(self._name, 0.0) + spent
      self._name = ""
    return sum(self.stages.values())
