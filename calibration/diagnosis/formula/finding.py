"""A formula for what has no name: where it acts, what it is a function of, and the twin with it."""

import dataclasses
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.formula.columns import Driven, Fitted
from calibration.diagnosis.formula.forms import Form, Forms, forms_of
from calibration.diagnosis.formula.moments import fading, moments, variables
from calibration.diagnosis.formula.pulses import DRIVEN, Responses, readable, responses
from calibration.diagnosis.formula.recovery import Base, Recovered, recover
from calibration.diagnosis.formula.refit import (
  Option,
  Refitted,
  fitted_best,
  mechanism_of,
  refitted,
  table_of,
)
from calibration.diagnosis.formula.replay import replayed
from calibration.diagnosis.formula.tables import table_heights
from calibration.diagnosis.formula.thinned import thinned
from calibration.fitting.likelihood import Problem
from calibration.intervals.clusters import groups_of
from calibration.progress import Progress, silent
from qcar_twin.parameters import ParameterSet

Array = NDArray[np.float64]

STAGE = "formula for the rest"
_WINNER, _FORCES, _FORMS = 0.2, 0.2, 0.2  # of the time: the model's minimum, forces over time, forms; trials the rest
_ASKED = 3  # degrees of freedom, those of the largest evidence, whose forms are sought
_ALIKE = 10.0  # nats of evidence within which two degrees of freedom can't be told apart


@dataclasses.dataclass(frozen=True)
class Sought:
  """One degree of freedom that was looked into.

  Attributes:
    recovered: its force over time.
    responses: its columns.
    driven: the driving with that force.
    forms: None where nothing is worth its coefficients.
  """

  recovered: Recovered
  responses: Responses
  driven: Driven
  forms: Forms | None


@dataclasses.dataclass(frozen=True)
class Found:
  """What is known of what has no name.

  Attributes:
    sought: the degree of freedom it is put down to, and what is known there.
    alike: other degrees of freedom that explain it as well.
    kind: "formula", "table" or "" where neither is shipped.
    why: that neither is, in words; "".
    twin: with it in the simulator; None where nothing was worth a trial.
    seconds: that it took.
  """

  sought: Sought | None
  alike: tuple[str, ...]
  kind: str
  why: str
  twin: Refitted | None
  seconds: float

  @property
  def form(self) -> Form | None:
    """The formula that is shipped."""
    forms = self.sought.forms if self.sought else None
    return forms.best if forms and self.kind == "formula" else None


def find_formula(
  problem: Problem, winner: Candidate, came: Candidate, priors: ParameterSet, seed: int = 0, progress: Progress = silent
) -> Found:
  """Look for a formula for what a fitted model leaves over.

  Args:
    problem: with the model's weights.
    winner: the model, fitted to its minimum.
    came: the same where it stood before.
    priors: declarations of the base parameters.
    seed: of halves and signs that are drawn.
    progress: reports the share that is done.
  """
  with threadpool_limits(1):  # many small matrices: a second thread costs more than it brings
    moved = np.abs(came.values - winner.values) > winner.std  # else it is the same place
    return _found(problem, [winner, came] if moved.any() else [winner], priors, seed, progress)


def _found(problem: Problem, bases: list[Candidate], priors: ParameterSet, seed: int, progress: Progress) -> Found:
  began, random = time.perf_counter(), np.random.default_rng(seed)
  part, model = thinned(problem, bases[0])
  fitted = _fitted(part, model)
  degrees, found = (*DRIVEN, *readable(part.observations)), []
  for k, name in enumerate(degrees):
    progress(STAGE, _WINNER + _FORCES * k / len(degrees))
    found.append(recovered(part, model, fitted.base, name))
  found.sort(key=lambda pair: -pair[0].evidence)
  asked, twins = _worth_asking(found)
  sought = []
  for k, pair in enumerate(asked):
    progress(STAGE, _WINNER + _FORCES + _FORMS * k / len(asked))
    sought.append(look_into(part, model, fitted, *pair, random))
  there = [s for s in sought if s.forms and s.forms.there]
  over = lambda: time.perf_counter() - began
  if not there:
    return Found(None, (), "", "what is left follows nothing that a formula was tried with", None, over())
  best = max(there, key=lambda s: s.forms.gain if s.forms else 0.0)
  alike = tuple(s.recovered.degree for s in there if s is not best and _as_good(s, best))
  progress(STAGE, _WINNER + _FORCES + _FORMS)
  alike += tuple(twins.get(best.recovered.degree, ()))
  kind, why, twin = shipped(problem, bases, priors, best, fitted)
  return Found(best, alike, kind, why, twin, over())


def _fitted(part: Problem, model: Candidate) -> Fitted:
  observations, base = part.observations, Base.of(model)
  second = observations.recording * 1_000_000 + observations.time.astype(np.int64)
  return Fitted(base, base.rest, groups_of(observations), second)


def recovered(problem: Problem, winner: Candidate, base: Base, degree: str) -> tuple[Recovered, Responses]:
  """A degree of freedom's force over time, and the columns it came from."""
  answers = responses(problem, winner.theta, degree)
  return recover(base, answers), answers


def look_into(
  problem: Problem,
  winner: Candidate,
  fitted: Fitted,
  force: Recovered,
  answers: Responses,
  random: np.random.Generator,
) -> Sought:
  """What a degree of freedom's force is a function of."""
  observations, twin = problem.observations, problem.twin
  prediction = replayed(problem, winner.theta, force)
  context = moments(twin, winner.theta, observations, prediction)
  stretches = observations.stretches
  driven = Driven(variables(context, observations), fading(context, stretches), twin.car, stretches.segments.period)
  return Sought(force, answers, driven, forms_of(answers, driven, fitted, random))


def shipped(
  problem: Problem, bases: list[Candidate], priors: ParameterSet, best: Sought, fitted: Fitted
) -> tuple[str, str, Refitted | None]:
  """What goes into the twin, a word; why nothing does; and the trial in the simulator."""
  forms, twin = best.forms, None
  assert forms is not None
  tried = lambda options: refitted(problem, bases[0], priors, fitted_best(problem, bases, priors, options), best.driven)
  if forms.found:
    twin = tried(_options(problem, best))
    if good(twin):
      return "formula", "", twin
  if not forms.tabled:
    return "", "no formula holds, and no table of one or two variables does", twin
  tabled = tried([_table(best, fitted)])
  if good(tabled):
    return "table", "", tabled
  return "", "in the simulator it does not predict recordings better that took no part in the fit", twin or tabled


def _options(problem: Problem, where: Sought) -> list[Option]:
  """The formulas of a degree of freedom that do about as well, and others of the same variables."""
  assert where.forms is not None
  forms, unit = where.forms, problem.twin.vehicle.motor.unit
  tried = {f.terms: f for f in (forms.best, *forms.rivals, *forms.siblings)}
  return [(*mechanism_of(f, where.driven, unit), sum(g.nats for g in f.groups)) for f in tried.values()]


def _table(where: Sought, fitted: Fitted) -> Option:
  assert where.forms is not None
  names, stiffness = where.forms.table.names, where.forms.table.stiffness
  heights = table_heights(where.responses, where.driven, fitted, names, stiffness)
  return (*table_of(where.recovered.degree, names, heights, where.driven, stiffness), 0.0)


def good(twin: Refitted) -> bool:
  """Whether a twin with it is better held out, and on recordings that only judge, where there are some."""
  return twin.held_out.gain > 0.0 and (twin.judged is None or twin.judged.gain > 0.0)


Pair = tuple[Recovered, Responses]


def _worth_asking(found: Sequence[Pair]) -> tuple[list[Pair], dict[str, list[str]]]:
  """Degrees of freedom of the largest evidence; and which others are as good as one of them.

  A torque of the motor pushes the car as a force along it does, but for what the tyres slip: where the evidence does
  not tell them apart, the force stands for both.
  """
  there = [pair for pair in found if pair[0].evidence > 0.0]
  evidence = {pair[0].degree: pair[0].evidence for pair in there}
  both = {"force_x", "motor_torque"} <= set(evidence)
  if both and abs(evidence["force_x"] - evidence["motor_torque"]) < _ALIKE:
    there = [pair for pair in there if pair[0].degree != "motor_torque"]
    return there[:_ASKED], {"force_x": ["motor_torque"]}
  return there[:_ASKED], {}


def _as_good(one: Sought, best: Sought) -> bool:
  assert one.forms and best.forms
  return one.forms.gain > best.forms.gain - _ALIKE
