"""Calibration of the twin: to the identified model's step responses, or to the recordings themselves.

  calibration = calibrate(DataSet.load("data/sample"), against="recordings", folder="out/sample")
  calibration.write("out/sample")          # twin.toml, calibration.json, report.html

Against "identified" the twin answers voltage steps and step steers like the bicycle (`match`). Against
"recordings" it is the maximum a posteriori over all recordings with role "identify" (`recalibrate`), started
from the identified model where there is one; role "validate" judges, role "holdout" stays closed.
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

from calibration.diagnosis.passport import noise_passport
from calibration.diagnosis.recalibrate import BIAS_MECHANISMS, recalibrate, sensor_floor, with_sensor_biases
from calibration.first_guess import first_guess
from calibration.fit import Fit, with_jacobian
from calibration.identify import Identification, SteadyState, identify
from calibration.longitudinal import NotIdentifiable
from calibration.match import PARTS, Answer, StepComparison, bicycle_values, levels_of, match_bicycle, mean_percent
from calibration.observations import UNITS, observe
from calibration.segmenting import Cut
from calibration.stages import Stages, fingerprint
from calibration.standing import split_standing
from qcar_twin.dataset import DataSet
from qcar_twin.mechanisms import select
from qcar_twin.parameters import ParameterSet
from qcar_twin.recording import Recording
from qcar_twin.twin import Twin
from qcar_twin.twin_file import save_twin
from qcar_twin.twin_parameters import informed
from qcar_twin.vehicle import Vehicle
from qcar_twin.whole_file import write_json

Array = NDArray[np.float64]
Against = Literal["identified", "recordings"]
Progress = Callable[[str], None]

LONGEST = 420.0  # s of driving that are fitted; longer data sets are sampled evenly
QUICK = 40.0
FINE = 5  # simulation steps per control period of the final numbers: 2 ms
_UNSEEN = 0.5  # a prior deviation of a parameter moves all residuals together by less than this: nothing shows it
_OFF = 3.0  # prior deviations that are worth a word


@dataclasses.dataclass(frozen=True)
class Estimate:
  """One parameter after calibration, in `unit`.

  Attributes:
    held: why it was not fitted, or that nothing in the recordings shows it; "" for a fitted one.
  """

  value: float
  std: float
  unit: str
  prior: float
  prior_std: float
  at_bound: bool
  identifiable: bool
  held: str = ""


@dataclasses.dataclass(frozen=True)
class ChannelError:
  """Root mean square error on recordings before and after calibration, and the sensor's own noise, in `unit`."""

  before: float
  after: float
  noise_floor: float
  unit: str


@dataclasses.dataclass(frozen=True)
class Calibration:
  """A calibrated twin.

  Attributes:
    twin, theta: the car at 2 ms steps and its parameter vector, (P,).
    estimates: every parameter by name.
    identification: the bicycle; None where `missing` says why.
    answers: step responses of twin and bicycle.
    errors: role -> channel -> error on the stretches of recordings that were used; empty against "identified".
    shift: control periods by which commands act later than logged.
    notes: what a reader must know.
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
  shift: int
  notes: tuple[str, ...]
  seconds: float

  def step_percent(self, part: str, role: str | None = None) -> float:
    """Mean difference from the bicycle on steps, per cent: part "longitudinal", "lateral" or "yaw_rate"."""
    return mean_percent(self.answers, part, role)

  def document(self) -> dict[str, Any]:
    """What calibration.json holds."""
    steps = {p: {r: self.step_percent(p, r) for r in ("identify", "validate")} for p in PARTS}
    found = self.identification
    return {
      "dataset": self.dataset.name,
      "against": self.against,
      "parameters": {name: dataclasses.asdict(e) for name, e in self.estimates.items()},
      "identified": dict(zip(("P1", "P2", "P3", "C_f", "C_r"), found.theta, strict=True)) if found else None,
      "steps_rmse_percent": steps,
      "errors": {r: {c: dataclasses.asdict(e) for c, e in items.items()} for r, items in self.errors.items()},
      "command_shift": self.shift,
      "notes": list(self.notes),
      "seconds": round(self.seconds, 1),
    }

  def write(self, folder: str | os.PathLike[str]) -> Path:
    """Write twin.toml, calibration.json and report.html; returns the report's path."""
    from calibration.report.calibration import write_report  # the page knows this module, not the other way round

    folder = Path(folder)
    save_twin(folder / "twin.toml", self.twin, self.theta, f"calibrated on {self.dataset.name} against {self.against}")
    write_json(folder / "calibration.json", self.document())
    return write_report(folder / "report.html", self)


def calibrate(
  dataset: DataSet,
  against: Against = "identified",
  folder: str | os.PathLike[str] | None = None,
  mechanisms: Sequence[str] = (),
  steady_state: SteadyState = "exact",
  quick: bool = False,
  threads: int = 0,
  progress: Progress = lambda text: None,
) -> Calibration:
  """Fit the twin of a data set's car.

  Args:
    against: "identified" or "recordings".
    folder: where stage results are kept; a broken-off run with the same folder, data and options goes on from them.
    mechanisms: ids of the catalogue this car is known to need; fitted with the rest against "recordings".
    steady_state: of the identification.
    quick: about 40 s of driving and few iterations, for a first look.
    threads: of the simulation, 0 for all cores; results don't depend on it.
    progress: told what is being done.

  Raises:
    NotIdentifiable: against "identified" without voltage steps that identify the drive.
  """
  began = time.perf_counter()
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  progress("identification")
  identification, missing = _identified(dataset, steady_state, vehicle)
  stages = Stages(
    folder and Path(folder) / "stages", fingerprint(dataset), against, tuple(mechanisms), steady_state, quick
  )
  if against == "identified":
    if identification is None:
      raise NotIdentifiable(f"{missing}; or calibrate against the recordings themselves (--against recordings)")
    twin = Twin(vehicle, substeps=2, threads=threads)
    work = lambda: _to_bicycle(twin, identification, quick, progress)
  else:
    biases = [] if set(mechanisms) & set(BIAS_MECHANISMS) else list(BIAS_MECHANISMS)
    twin = Twin(vehicle, select([*mechanisms, *biases]), substeps=2, threads=threads)
    work = lambda: _to_recordings(twin, dataset, identification, mechanisms, quick, progress)
  found = stages.kept("fit")
  if found:
    progress("fit taken from an earlier run")
  else:
    found = stages.keep("fit", work())
  estimates = {name: _estimate(e) for name, e in found["estimates"].items()}
  theta = twin.parameters.vector({name: e.value for name, e in estimates.items()})
  progress("comparison")
  fine = Twin(vehicle, twin.mechanisms, substeps=FINE, threads=threads)
  answers = _answers(fine, theta, identification) if identification else ()
  errors = _errors(fine, theta, dataset, found["shift"], quick) if against == "recordings" else {}
  notes = (*dataset.warnings, *found["notes"], *_judged(estimates))
  return Calibration(dataset, against, fine, theta, estimates, identification, missing, answers, errors,
                     found["shift"], notes, time.perf_counter() - began)  # fmt: skip


def _identified(dataset: DataSet, steady_state: SteadyState, vehicle: Vehicle) -> tuple[Identification | None, str]:
  try:
    found = identify(dataset, steady_state, vehicle=vehicle)
  except NotIdentifiable as error:
    return None, str(error)
  return found, found.missing


# -- the two fits --------------------------------------------------------------------------------


def _to_bicycle(twin: Twin, identification: Identification, quick: bool, progress: Progress) -> dict[str, Any]:
  tell = lambda k, cost: progress(f"fit to the identified model, iteration {k}, cost {cost:.0f}")
  match = match_bicycle(twin, identification, twin.base, iterations=3 if quick else 12, progress=tell)
  estimates = _table(match.fit, twin.base, "the identified model does not show it")
  notes = [*identification.drive.notes, *(identification.lateral.notes if identification.lateral else ())]
  lags = [n for n in ("servo_time_constant", "relaxation_length") if estimates.get(n, {}).get("at_bound")]
  if lags:
    notes.append(
      f"{' and '.join(lags)} went to the bound: the identified model answers without lag. A twin for driving is"
      " calibrated against the recordings"
    )
  if identification.lateral is None:
    notes.append(f"tyres stay at their priors: {identification.missing}")
  return {"estimates": estimates, "shift": 0, "notes": notes}


def _to_recordings(
  twin: Twin,
  dataset: DataSet,
  identification: Identification | None,
  mechanisms: Sequence[str],
  quick: bool,
  progress: Progress,
) -> dict[str, Any]:
  recordings, standing = split_standing(_open_recordings(dataset))
  base = first_guess(recordings, twin.vehicle)
  if identification and identification.lateral:
    tyres = {k: v for k, v in bicycle_values(identification, twin).items() if k.startswith("cornering")}
    base = informed(base, tyres)
  added = [p for m in twin.mechanisms if m.name in mechanisms and m.name not in BIAS_MECHANISMS for p in m.parameters]
  priors = with_sensor_biases(base, twin, recordings) + added
  shifts = (-1, 0, 1) if dataset.command_timing == "unknown" else (0,)
  baseline = recalibrate(twin, recordings, priors, shifts, _cut(quick, 0), progress=progress)
  notes = ["no steering_command is logged: the car is taken to drive straight"]
  if any("steering_command" in r for r in recordings):
    notes = []
  if len(shifts) > 1:
    notes.append(f"the log's command timing is unknown; commands fit best {baseline.shift} control periods later")
  if standing:
    notes.append(f"static friction holds the car in {', '.join(standing)}: left out of the fit, not of the errors")
  fresh = with_jacobian(baseline.fit, baseline.jacobian[: len(baseline.fit.residual)], np.inf)
  estimates = _table(fresh, twin.parameters, "not fitted")
  return {"estimates": estimates, "shift": int(baseline.shift), "notes": notes}


def _open_recordings(dataset: DataSet) -> list[Recording]:
  return [r for r in dataset.recordings if r.role != "holdout"]


def _cut(quick: bool, shift: int) -> Cut:
  return Cut(most=QUICK if quick else LONGEST, shift=shift)


def _table(found: Fit, every: ParameterSet, reason: str) -> dict[str, dict[str, Any]]:
  """Estimates of all parameters; what no residual shows goes back to its prior."""
  force = np.sqrt(np.sum(np.square(found.jacobian), axis=0)) * found.parameters.std
  table = {}
  for p in every:
    if p.name not in found.parameters:
      table[p.name] = _held(p.nominal, p.nominal, p.std or (p.upper - p.lower) / 3.0, p.unit, reason)
      continue
    i = found.parameters.index(p.name)
    row = found.table()[p.name]
    if force[i] < _UNSEEN:
      row = _held(row["prior"], row["prior"], row["prior_std"], p.unit, "no recording shows it")
    table[p.name] = row
  return table


def _held(value: Any, prior: Any, std: Any, unit: str, reason: str) -> dict[str, Any]:
  return {"value": value, "std": std, "unit": unit, "prior": prior, "prior_std": std,
          "at_bound": False, "identifiable": False, "held": reason}  # fmt: skip


def _estimate(row: Mapping[str, Any]) -> Estimate:
  """From a stored row, where an unknown number is null."""
  known: dict[str, Any] = {key: np.nan if value is None else value for key, value in row.items()}
  return Estimate(**known)


# -- judging -------------------------------------------------------------------------------------


def _answers(twin: Twin, theta: Array, identification: Identification) -> tuple[Answer, ...]:
  bicycle, values = identification.bicycle(twin.vehicle)
  return StepComparison(twin, bicycle, values, *levels_of(identification)).answers(theta, values)


def _errors(twin: Twin, theta: Array, dataset: DataSet, shift: int, quick: bool) -> dict[str, dict[str, ChannelError]]:
  """Errors of the uncalibrated and the calibrated twin by role and channel."""
  recordings = _open_recordings(dataset)
  floor = sensor_floor(noise_passport(recordings))
  observations = observe(recordings, twin.vehicle, _cut(quick, shift))
  both = np.stack([twin.parameters.nominal, theta])
  wrong = observations.predict(twin.rollout(both, observations.stretches.segments)) - observations.measured
  roles = np.array([r.role for r in recordings])[observations.recording]
  errors: dict[str, dict[str, ChannelError]] = {}
  for role in ("identify", "validate"):
    for channel in observations.present:
      rows = (roles == role) & observations.select(channel)
      if rows.any():
        before, after = np.sqrt(np.mean(np.square(wrong[:, rows]), axis=1)).tolist()
        noise = floor.get(channel, float("nan"))
        errors.setdefault(role, {})[channel] = ChannelError(before, after, noise, UNITS[channel])
  return errors


def _judged(estimates: Mapping[str, Estimate]) -> list[str]:
  """Words on parameters at a bound, unseen, or far from what was measured."""
  unseen = [n for n, e in estimates.items() if e.held == "no recording shows it"]
  bound = [n for n, e in estimates.items() if e.at_bound]
  far = {n: (e.value - e.prior) / e.prior_std for n, e in estimates.items() if not e.held and e.prior_std > 0}
  far = {n: share for n, share in far.items() if abs(share) > _OFF}
  notes = []
  if unseen:
    notes.append(f"no recording shows {', '.join(unseen)}: left at the prior")
  if bound:
    notes.append(f"at a bound of the fit: {', '.join(bound)}")
  if far:
    listed = ", ".join(f"{n} {share:+.1f}" for n, share in far.items())
    notes.append(f"far from the prior, in prior deviations: {listed}; something the twin lacks may hide here")
  return notes
