"""Calibration of the twin: to the identified model's step responses, or to the recordings themselves.

  calibration = calibrate(DataSet.load("data/sample"), against="recordings", folder="out/sample")
  write_calibration(calibration, "out/sample")  # twin.toml, calibration.json, report.html

Against "identified" the twin answers voltage steps and step steers like the bicycle (`match`). Against
"recordings" it is the maximum a posteriori over all recordings with role "identify" (`recalibrate_dataset`), the
twin that a diagnosis starts from; role "validate" judges, role "holdout" stays closed.
What the recordings can't show stays at its prior and is said.
"""

import dataclasses
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.dataset_recalibration import LONGEST, command_shifts, recalibrate_dataset
from calibration.fitting.informative import split_standing
from calibration.fitting.noise import noise_models
from calibration.fitting.noise_floor import driving_noise, residual_floor, sensor_floor
from calibration.fitting.observations import UNITS, Observations, observe
from calibration.fitting.optimiser import with_jacobian
from calibration.fitting.recalibration import RecalibratedTwin
from calibration.fitting.surrogate import searching
from calibration.fitting.tolerances import always_fitted
from calibration.fitting.windows import Cut
from calibration.identification.drive_fit import NotIdentifiable
from calibration.identification.identification import Identification, SteadyState, identify
from calibration.identification.match_bicycle import (
  PARTS,
  Answer,
  StepComparison,
  levels_of,
  match_bicycle,
  mean_percent,
)
from calibration.intervals.clusters import groups_of
from calibration.log_check.ready import fitted_ages, ready
from calibration.progress import Progress, silent
from calibration.twin_calibration.estimates import Estimate, estimate_of, judged, table_of
from calibration.twin_calibration.stage_cache import Stages, fingerprint
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
Against = Literal["identified", "recordings"]
Recalibrated = Callable[[], RecalibratedTwin] | None

QUICK = 40.0  # s of driving that are fitted for a first look
_STRAIGHT = "no steering_command is logged: the car is taken to drive straight"


@dataclasses.dataclass(frozen=True)
class ChannelError:
  """Root mean square error on recordings before and after calibration, and the sensor's own noise, in `unit`."""

  before: float
  after: float
  noise_floor: float
  unit: str


@dataclasses.dataclass(frozen=True, eq=False)
class Replay:
  """What was measured, and predicted before and after calibration, (2, M), in the channels' units."""

  observations: Observations
  predicted: Array


@dataclasses.dataclass(frozen=True)
class Calibration:
  """A calibrated twin.

  Attributes:
    twin, theta: the car at 2 ms steps and its parameter vector, (P,).
    estimates: every parameter by name.
    identification: the bicycle; None where `missing` says why.
    answers: step responses of twin and bicycle.
    errors: role -> channel -> error on the stretches of recordings that were used; empty against "identified".
    command_shift: control periods by which commands act later than logged.
    notes: what a reader must know.
    replay: the recordings that were used with what the twin made of them; None against "identified".
  """

  dataset: DataSet
  against: Against
  twin: Twin
  theta: Array
  estimates: Mapping[str, Estimate]
  identification: Identification | None
  missing: str
  answers: tuple[Answer, ...]
  errors: Mapping[str, Mapping[str, ChannelError]]
  command_shift: int
  notes: tuple[str, ...]
  seconds: float
  replay: Replay | None = None

  def step_percent(self, part: str, role: str | None = None) -> float:
    """Mean difference from the bicycle on steps, per cent: part "longitudinal", "lateral" or "yaw_rate"."""
    return mean_percent(self.answers, part, role)

  def document(self) -> dict[str, Any]:
    """What calibration.json holds."""
    steps = {p: {r: self.step_percent(p, r) for r in ("identify", "validate")} for p in PARTS}
    identified = self.identification
    return {
      "dataset": self.dataset.name,
      "against": self.against,
      "parameters": {name: dataclasses.asdict(e) for name, e in self.estimates.items()},
      "identified": dict(zip(("P1", "P2", "P3", "C_f", "C_r"), identified.theta, strict=True)) if identified else None,
      "steps_rmse_percent": steps,
      "errors": {r: {c: dataclasses.asdict(e) for c, e in items.items()} for r, items in self.errors.items()},
      "command_shift": self.command_shift,
      "notes": list(self.notes),
      "seconds": round(self.seconds, 1),
    }


def calibrate(
  dataset: DataSet,
  against: Against = "identified",
  folder: str | os.PathLike[str] | None = None,
  add_mechanisms: Sequence[str] = (),
  steady_state: SteadyState = "exact",
  quick: bool = False,
  threads: int = 0,
  progress: Progress = silent,
  recalibrated: Recalibrated = None,
  plant: EngineKind = "reduced",
) -> Calibration:
  """Fit the twin of a data set's car.

  Args:
    against: "identified" or "recordings".
    folder: where stage results are kept; a broken-off run with the same folder, data and options goes on from them.
    add_mechanisms: ids of the catalogue this car is known to need; added and fitted with the rest against "recordings".
    steady_state: of the identification.
    quick: about 40 s of driving and few iterations, for a first look.
    threads: of the simulation, 0 for all cores; results don't depend on it.
    progress: reports what is being done.
    recalibrated: gives this data set's recalibrated twin where a diagnosis made it; see diagnosis.pipeline.prepare.
    plant: what is searched with against "recordings"; see `diagnose`.

  Raises:
    NotIdentifiable: against "identified" without voltage steps that identify the drive.
  """
  began, warned, said = time.perf_counter(), (), ()
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  progress("identification")
  identification, missing = _identified(dataset, steady_state, vehicle)
  stages = Stages(
    folder and Path(folder) / "stages", fingerprint(dataset), against, tuple(add_mechanisms), steady_state, quick, plant
  )
  if against == "identified":
    if identification is None:
      raise NotIdentifiable(f"{missing}; or calibrate against the recordings themselves (--against recordings)")
    twin = Twin(vehicle, threads=threads)
    work = lambda: _to_bicycle(twin, identification, quick, progress)
  else:
    dataset, warned = ready(dataset, QUICK if quick else LONGEST)
    # in the order of the catalogue, in which a diagnosis applies them: the same bits
    twin = Twin(vehicle, select(sorted({*add_mechanisms, *always_fitted(vehicle.drive)})), threads=threads)
    searched, said = searching(twin, plant)
    work = lambda: _to_recordings(searched, dataset, add_mechanisms, quick, recalibrated, progress)
  fitted = stages.kept("fit")
  if fitted:
    progress("fit taken from an earlier run")
  else:
    fitted = stages.keep("fit", work())
  estimates = {name: estimate_of(e) for name, e in fitted["estimates"].items()}
  theta = twin.parameters.vector({name: e.value for name, e in estimates.items()})
  progress("comparison")
  answers = _answers(twin, theta, identification) if identification else ()
  replay = _replay(twin, theta, dataset, fitted["command_shift"], quick) if against == "recordings" else None
  notes = (*warned, *dataset.notices, *said, *fitted["notes"], *judged(estimates))
  return Calibration(dataset, against, twin, theta, estimates, identification, missing, answers,
    _errors(replay, dataset), fitted["command_shift"], notes, time.perf_counter() - began, replay)  # fmt: skip


def _identified(dataset: DataSet, steady_state: SteadyState, vehicle: Vehicle) -> tuple[Identification | None, str]:
  try:
    identification = identify(dataset, steady_state, vehicle=vehicle)
  except NotIdentifiable as error:
    return None, str(error)
  return identification, identification.missing


# -- the two fits --------------------------------------------------------------------------------


def _to_bicycle(twin: Twin, identification: Identification, quick: bool, progress: Progress) -> dict[str, Any]:
  tell = lambda k, cost: progress(f"fit to the identified model, iteration {k}, cost {cost:.0f}")
  match = match_bicycle(twin, identification, twin.base, iterations=3 if quick else 12, progress=tell)
  estimates = table_of(match.fit, twin, twin.base, "the identified model does not show it", None)
  notes = [*identification.drive.notes, *(identification.lateral.notes if identification.lateral else ())]
  lags = [n for n in ("servo_time_constant", "relaxation_length") if estimates.get(n, {}).get("at_bound")]
  if lags:
    notes.append(
      f"{' and '.join(lags)} went to the bound: the identified model answers without lag. A twin for driving is"
      " calibrated against the recordings"
    )
  if identification.lateral is None:
    notes.append(f"tyres stay at their priors: {identification.missing}")
  return {"estimates": estimates, "command_shift": 0, "notes": notes}


def _to_recordings(
  twin: Twin, dataset: DataSet, names: Sequence[str], quick: bool, recalibrated: Recalibrated, progress: Progress
) -> dict[str, Any]:
  fitted, standing = split_standing(dataset.recordings)
  if recalibrated is None or standing:
    added = [p for m in twin.mechanisms if m.name in names for p in m.parameters]
    kept = dataclasses.replace(dataset, recordings=tuple(fitted))
    ages, most = fitted_ages(kept, twin.vehicle), QUICK if quick else LONGEST
    again = recalibrate_dataset(kept, twin, added=added, most=most, progress=progress, ages=ages)
  else:
    again = recalibrated()
  notes = [] if any("steering_command" in r for r in fitted) else [_STRAIGHT]
  if len(command_shifts(dataset)) > 1:
    notes.append(f"the log's command timing is unknown; commands fit best {again.command_shift} control periods later")
  if standing:
    notes.append(f"static friction holds the car in {', '.join(standing)}: left out of the fit, not of the errors")
  group = groups_of(again.problem.observations)[: again.problem.n_train]
  best = with_jacobian(again.fit, again.jacobian[: again.problem.n_train], np.inf)
  clear = again.problem.clear(residual_floor(driving_noise(fitted)))
  estimates = table_of(best, twin, twin.parameters, "not fitted", group, clear)
  return {"estimates": estimates, "command_shift": int(again.command_shift), "notes": notes}


def _open_recordings(dataset: DataSet) -> list[Recording]:
  return [r for r in dataset.recordings if r.role != "holdout"]


# -- judging -------------------------------------------------------------------------------------


def _answers(twin: Twin, theta: Array, identification: Identification) -> tuple[Answer, ...]:
  bicycle, values = identification.bicycle(twin.vehicle)
  return StepComparison(twin, bicycle, values, *levels_of(identification)).answers(theta, values)


def _replay(twin: Twin, theta: Array, dataset: DataSet, command_shift: int, quick: bool) -> Replay:
  """The uncalibrated and the calibrated twin on every recording but those held out."""
  cut = Cut(most=QUICK if quick else LONGEST, command_shift=command_shift)
  observations = observe(_open_recordings(dataset), twin.vehicle, cut)
  both = np.stack([twin.parameters.nominal, theta])
  return Replay(observations, observations.predict(twin.rollout(both, observations.stretches.segments)))


def _errors(replay: Replay | None, dataset: DataSet) -> dict[str, dict[str, ChannelError]]:
  """Errors of the uncalibrated and the calibrated twin by role and channel."""
  if replay is None:
    return {}
  recordings, observations = _open_recordings(dataset), replay.observations
  floor = sensor_floor(noise_models(recordings))
  roles = np.array([r.role for r in recordings])[observations.recording]
  errors: dict[str, dict[str, ChannelError]] = {}
  for role in ("identify", "validate"):
    for channel in observations.present:
      rows = (roles == role) & observations.select(channel)
      if rows.any():
        wrong, noise = replay.predicted[:, rows] - observations.measured[rows], floor.get(channel, float("nan"))
        before, after = np.sqrt(np.mean(np.square(wrong), axis=1)).tolist()
        errors.setdefault(role, {})[channel] = ChannelError(before, after, noise, UNITS[channel])
  return errors
