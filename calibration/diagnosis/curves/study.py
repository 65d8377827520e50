"""What a free base reaches on a data set, beside today's base, named forms alone and a black box."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.black_box import boosted_residual, rms
from calibration.diagnosis.curves.driven import driven, error_of
from calibration.diagnosis.curves.finish import finished, fitted_to_all
from calibration.diagnosis.curves.flexible import DELAYS, Characterised, characterise, fitted_on
from calibration.diagnosis.curves.naming.additions import Addition, with_additions
from calibration.diagnosis.curves.naming.bounds import said
from calibration.diagnosis.curves.naming.families import made_simpler
from calibration.diagnosis.curves.naming.forms import Form, Outline, left_with, outlines, redrawn
from calibration.diagnosis.curves.naming.refits import Trials
from calibration.diagnosis.curves.naming.removals import matters, without_the_needless
from calibration.diagnosis.curves.naming.rivals import renamed, with_rivals
from calibration.diagnosis.curves.naming.substitution import named_again, named_only, substituted
from calibration.diagnosis.curves.naming.terms import Term, terms
from calibration.diagnosis.curves.naming.youngest import by_the_youngest
from calibration.diagnosis.holdout_errors import ratio
from calibration.diagnosis.shipping import Written
from calibration.fitting.dataset_recalibration import LONGEST, recalibrate_dataset
from calibration.fitting.likelihood import Problem
from calibration.fitting.noise_floor import driving_noise, residual_floor
from calibration.fitting.observations import UNITS, Observations
from calibration.fitting.recalibration import RecalibratedTwin
from calibration.fitting.tolerances import always_fitted
from calibration.log_check.ready import fitted_ages, ready
from calibration.progress import Progress, silent
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

KINDS = ("base", "curves", "characterised", "named", "black_box", "black_box_on_characterised", "noise")
_SHIPPED = ("base", "curves", "characterised", "named")


@dataclasses.dataclass(frozen=True)
class Study:
  """Four twins of one car on recordings that took no part.

  Attributes:
    dataset: name; notes: what its check said.
    found: the twin with curves; outlines: its curves and the forms they may have.
    told: the twin that is told of: named forms where they will do, no curve where none departs, curves where no form
      will do, and the effects that joined (`additions`).
    terms: every number in it beside the base's own.
    named: the same with the best form where none will do; `told` itself where there is no such curve.
    judged: as `errors`, of the twins on recordings that only judged (role "validate"), before they were fitted to
      those, too (`finish`); {} without such recordings. `as_judged`: those twins, by kind.
    errors: by KINDS, then channel: root mean square errors on the hold-out, in `units`; "noise" is the sensors' while
      driving.
  """

  dataset: str
  notes: tuple[str, ...]
  found: Characterised
  outlines: tuple[Outline, ...]
  told: Characterised
  additions: tuple[Addition, ...]
  terms: tuple[Term, ...]
  named: Characterised
  errors: Mapping[str, Mapping[str, float]]
  units: Mapping[str, str]
  base: RecalibratedTwin
  judged: Mapping[str, Mapping[str, float]]
  as_judged: Mapping[str, RecalibratedTwin | Characterised]

  @property
  def gain(self) -> float:
    """By which share the best twin's errors are smaller than the base's where they only judged; 0 without any."""
    return 1.0 - ratio(self.judged[self.best], self.judged["base"]) if self.judged else 0.0

  @property
  def best(self) -> str:
    """The kind of twin that errs least on recordings that only judged.

    Without any, the twin that is told of: what is in it was borne out by driving that it was not fitted to.
    """
    if not self.judged:
      found = any(o.is_there for o in self.outlines) or any(t.there for t in self.terms) or self.additions
      return "characterised" if found else "base"
    return min(_SHIPPED, key=lambda kind: ratio(self.judged[kind], self.judged["base"]))

  @property
  def shipped(self) -> Written:
    """The twin to go on with: the best."""
    return self._written({"base": self.base, "curves": self.found, "characterised": self.told, "named": self.named})

  @property
  def unseen(self) -> Written:
    """The best as it was before it was fitted to what judged: its errors there are those of a twin that judges."""
    return self._written(self.as_judged)

  def _written(self, twins: Mapping[str, RecalibratedTwin | Characterised]) -> Written:
    """The best of some twins as a file holds it: a lead of its commands is taken off its delays."""
    best, note = twins[self.best], f"characterised on {self.dataset}: curves of no known form"
    if isinstance(best, RecalibratedTwin):
      return Written(
        best.problem.exact.twin.on("mujoco"), best.theta, f"recalibrated on {self.dataset}", best.command_shift
      )
    shift = best.fitted.command_shift
    counted = max(shift, 0) if set(DELAYS) & set(best.beside) else shift
    return Written(best.twin, best.unshifted, f"{note}; sessions' own trims are left out", counted)

  def document(self) -> dict[str, Any]:
    """Everything a program may want of it, as plain values."""
    form = lambda f: None if f is None else dataclasses.asdict(f)
    curves = [
      {
        "curve": o.curve,
        "there": o.is_there,
        "p_without": o.departs,
        "places": list(o.places),
        "heights": o.heights.tolist(),
        "std": o.std.tolist(),
        "named": form(o.named),
        "nearly": form(o.nearly),
        "possible": [list(f.mechanisms) for f in o.possible],
      }
      for o in self.outlines
    ]
    return {
      "dataset": self.dataset,
      "notes": list(self.notes),
      "curves": curves,
      "terms": [dataclasses.asdict(t) for t in self.terms],
      "named_forms": list(self.named.forms),
      "additions": [
        {"mechanism": a.mechanism, "nats": a.test.nats, "t": a.test.t, "error_without": a.test.worse}
        for a in self.additions
      ],
      "holdout": {kind: dict(values) for kind, values in self.errors.items()},
      "units": dict(self.units),
      "command_shift": self.found.fitted.command_shift,
      "validate": {kind: dict(values) for kind, values in self.judged.items()},
      "validation_gain": self.gain,
      "best": self.best,
    }


def study(
  dataset: DataSet,
  most: float = LONGEST,
  threads: int = 0,
  progress: Progress = silent,
  plant: EngineKind = "reduced",
) -> Study:
  """Characterise a data set's car; the hold-out is opened at the end, once.

  Args:
    dataset: recordings with roles.
    most: s of driving that are simulated.
    threads: of the simulation, 0 for all cores.
    progress: reports the stage.
    plant: what is fitted on: the reduced car, or "mujoco", many times as long; errors are MuJoCo's either way.
  """
  dataset, notes = ready(dataset, most, evenly=True)
  progress("the base as it is")
  base = _base(dataset, most, threads, plant)
  progress("curves")
  found = characterise(dataset, most=most, threads=threads, plant=plant)
  trials, drawn = substituted(by_the_youngest(Trials.of(found)), outlines(found), progress)
  settled, exchanged, tests = with_rivals(with_additions(trials, progress), progress)
  whole = with_additions(settled, progress) if exchanged else settled
  grown = whole is not trials
  drawn = tuple(renamed(outline, exchanged, whole) for outline in drawn)
  whole, drawn = named_again(whole, drawn, progress) if grown else (whole, drawn)
  whole, drawn = made_simpler(whole, drawn, progress)
  trials, tests = without_the_needless(whole, progress, tests if whole is settled else None)
  in_the_end = [name for name in trials.forms if name not in tests or matters(tests, name)]
  drawn = tuple(left_with(outline, in_the_end) for outline in drawn)
  forms = {name for outline in drawn if outline.named for name in outline.named.mechanisms}
  joined = tuple(Addition(name, tests[name]) for name in in_the_end if name in tests and name not in forms)
  progress("fitting what is named to the end")
  told = trials.settled()
  named = named_only(trials, drawn).settled() if trials.curves else told
  twins = {"curves": found, "characterised": told, "named": named}
  judged, as_judged = _judged(base, twins, dataset.role("validate")), {"base": base, **twins}
  progress("fitting to what judged, too")
  base, found, named = fitted_to_all(base), finished(found), finished(named)
  told = finished(told) if trials.curves else named
  progress("hold-out")
  twins = {"curves": found, "characterised": told, "named": named}
  errors, units = _errors(base, twins, dataset.role("holdout"))
  wide = said(trials.problem, told.forms, told.fitted.fit.parameters)
  notes, drawn = dataset.notices + notes + wide, redrawn(drawn, found)
  return Study(
    dataset.name, notes, found, drawn, told, joined, terms(told, whole, tests), named, errors, units, base, judged,
    as_judged,
  )  # fmt: skip


def _base(dataset: DataSet, most: float, threads: int, plant: EngineKind) -> RecalibratedTwin:
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  searched = fitted_on(Twin(vehicle, select(always_fitted(vehicle.drive)), threads=threads), plant)
  return recalibrate_dataset(dataset, searched, most=most, evenly=True, ages=fitted_ages(dataset, vehicle))


def _judged(
  base: RecalibratedTwin, twins: Mapping[str, Characterised], judging: Sequence[Recording]
) -> dict[str, dict[str, float]]:
  if not judging:
    return {}
  return {"base": error_of(base, judging)} | {kind: error_of(twin.fitted, judging) for kind, twin in twins.items()}


def _errors(
  base: RecalibratedTwin, twins: Mapping[str, Characterised], holdout: Sequence[Recording]
) -> tuple[dict[str, dict[str, float]], dict[str, str]]:
  """Root mean square errors by kind and channel; {} without a hold-out."""
  if not holdout:
    return {}, {}
  observations, left, trees = _with_trees(base, holdout)
  errors = {"base": rms(observations, left)} | {kind: error_of(twin.fitted, holdout) for kind, twin in twins.items()}
  errors |= {"black_box": rms(observations, trees)}
  observations, _, trees = _with_trees(twins["characterised"].fitted, holdout)
  errors |= {"black_box_on_characterised": rms(observations, trees)}
  noise = residual_floor(driving_noise(holdout))
  errors["noise"] = {name: float(noise[name]) for name in observations.present if name in noise}
  return errors, {name: UNITS[name] for name in observations.present}


def _with_trees(found: RecalibratedTwin, recordings: Sequence[Recording]) -> tuple[Observations, Array, Array]:
  """A fitted twin on recordings: what was observed, and predicted minus measured without and with trees on top."""
  problem: Problem = found.problem.exact
  observations, prediction, left = driven(found, recordings)
  learnt = problem.predict(found.theta[None])
  residual = problem.observations.predict(learnt)[0] - problem.observations.measured
  return observations, left, boosted_residual(problem.observations, learnt, residual, observations, prediction, left)


def sentences(found: Study, holdout: bool = True) -> list[str]:
  """What the terminal says, a line a finding.

  Args:
    holdout: with the errors on hold-out recordings; a diagnosis has its own, from another base.
  """
  lines = []
  for outline in found.outlines:
    lines.append(f"{outline.curve}: {_said(outline)}")
  lines += [
    f"{a.mechanism} joins: without it the errors are {100.0 * (a.test.worse - 1.0):.0f} % larger"
    for a in found.additions
  ]
  there = [f"{t.name} = {t.value:.3g} ± {t.std:.1g} {t.unit}" for t in found.terms if t.there]
  lines.append("besides: " + ("; ".join(there) if there else "nothing that stands out from chance"))
  better = "better" if found.gain >= 0.0 else "worse"
  if found.judged:
    lines.append(
      f"on recordings that only judge the best, {found.best}, is {100.0 * abs(found.gain):.0f} % {better} than the base"
    )
  for channel, unit in found.units.items() if holdout else ():
    parts = [f"{kind.replace('_', ' ')} {found.errors[kind][channel]:.4g}" for kind in KINDS
             if channel in found.errors.get(kind, {})]  # fmt: skip
    lines.append(f"hold-out {channel} [{unit}]: " + ", ".join(parts))
  return lines


def _said(outline: Outline) -> str:
  form: Form | None = outline.told
  if not outline.is_there:
    return "no departure from the base car's law"
  if form is None:
    return "departs, as a curve of no known form (its table is in curves.json)"
  values = ", ".join(f"{n} = {v:.3g} ± {form.std[n]:.1g}" for n, v in form.values.items())
  if outline.nearly:
    share = f"which leave{'s' if len(form.mechanisms) == 1 else ''} {100.0 * outline.left(form):.0f} % of it"
    return f"departs nearly as {' and '.join(form.mechanisms)} would, {share}: {values}"
  others = len(outline.possible) - 1
  rivals = f" ({others} other forms fit, too)" if others else ""
  return f"departs as {' and '.join(form.mechanisms)} would: {values}{rivals}"
