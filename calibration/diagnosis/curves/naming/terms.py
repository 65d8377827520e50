"""The numbers beside the curves: their values, and whether the car has them."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration.diagnosis.curves.flexible import DELAYS, Characterised
from calibration.diagnosis.curves.naming.refits import Test, Trials
from calibration.diagnosis.curves.naming.removals import matters, stands_out
from calibration.diagnosis.curves.naming.sessions import contrasts
from calibration.diagnosis.score import clustered_std
from qcar_twin.parameters import ParameterSet


@dataclasses.dataclass(frozen=True)
class Term:
  """One number that was fitted beside the curves.

  Attributes:
    name: of the parameter, `parameter@session` for a session's own.
    value, std: in `unit`; the deviation counts a stretch of driving as one witness.
    there: the twin predicts worse without it or, where sessions have it as well, it differs from zero by more than
      chance over all of those.
    error_without: of the twin without it over the twin with it, on driving that neither was fitted to; None where that
      was not asked.
  """

  name: str
  value: float
  std: float
  unit: str
  there: bool
  error_without: float | None = None


def terms(told: Characterised, before: Trials, tests: Mapping[str, Test]) -> tuple[Term, ...]:
  """Every number beside the curves, as it is in a twin or, where the twin does without, as it was before.

  Args:
    told: the twin.
    before: the twin before anything was left out; tests: what it is worth against one without each mechanism.
  """
  free, inside = told.fitted.fit.parameters, _estimated(told)
  outside = _estimates(before)
  made = []
  for name in dict.fromkeys((*before.beside, *before.forms)):
    error = tests[name].worse if name in tests else None
    for parameter in before.problem.mechanism(name).parameters:
      if parameter.null == 0.0 and (parameter.name in inside or parameter.name in outside):
        there = parameter.name in inside and (name not in tests or matters(tests, name))
        value, spread = inside.get(parameter.name) or outside[parameter.name]
        made.append(_counted(Term(parameter.name, value, spread, parameter.unit, there, error), told.lead))
  return tuple(_by_chance(made, _of_sessions(free, inside), tests, before))


def _estimated(told: Characterised) -> dict[str, tuple[float, float]]:
  """Values and deviations of a twin's parameters; of sessions' shifts from their mean, and with it what they share."""
  names = told.fitted.fit.parameters.names
  weights = dict(zip(names, np.eye(len(names)), strict=True)) | contrasts(names)
  directions = np.array([weights[name] for name in names])
  std = np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", directions, told.covariance, directions), 0.0))
  return dict(zip(names, zip((directions @ told.fitted.fit.theta).tolist(), std.tolist(), strict=True), strict=True))


def _estimates(model: Trials) -> dict[str, tuple[float, float]]:
  """Values and deviations of a twin that is tried, by parameter."""
  spread = clustered_std(model.base, model.problem.observations)
  return {
    name: (value, std)
    for name, value, std in zip(model.base.free.names, model.base.values.tolist(), spread.tolist(), strict=True)
  }


def _counted(term: Term, lead: float) -> Term:
  """Delays from where the commands were moved to: a change may have acted anywhere between two of them."""
  if term.name not in DELAYS:
    return term
  return dataclasses.replace(term, value=term.value - lead, std=float(np.hypot(term.std, lead / np.sqrt(12.0))))


def _of_sessions(free: ParameterSet, inside: Mapping[str, tuple[float, float]]) -> list[Term]:
  """Departures of sessions from the mean of all: what they share is the car's."""
  return [Term(p.name, *inside[p.name], p.unit, False) for p in free if "@" in p.name]


def _by_chance(made: Sequence[Term], sessions: Sequence[Term], tests: Mapping[str, Test], before: Trials) -> list[Term]:
  """With the terms of sessions; they, and what they differ in, are there where they stand out from chance.

  No refit tells what sessions share from what they have of their own.
  """
  asked = {p.name for name in tests for p in before.problem.mechanism(name).parameters}
  kinds = {t.name.split("@")[0] for t in sessions} - asked
  count = len(sessions) + sum(t.name in kinds for t in made)
  tell = lambda t: dataclasses.replace(t, there=stands_out(t.value, t.std, count))
  return [*(tell(t) if t.name in kinds else t for t in made), *map(tell, sessions)]
