"""A formula for what has no name: where it acts, what it is a function of, and the twin with it."""

import dataclasses
import time

import numpy as np
from scipy.stats import t as student
from threadpoolctl import threadpool_limits

from calibration.diagnosis.candidates import Candidate, half_square
from calibration.diagnosis.formula.columns import Fitted
from calibration.diagnosis.formula.forms import MATERIAL, Form
from calibration.diagnosis.formula.looking import ALIKE, STAGE, Looked, Sought, gain, look, stood
from calibration.diagnosis.formula.places import placed
from calibration.diagnosis.formula.refit import Option, Refitted, fitted_best, refitted, table_of
from calibration.diagnosis.formula.tables import table_heights
from calibration.fitting.likelihood import Problem
from calibration.progress import Progress, silent
from qcar_twin.parameters import ParameterSet

_REFUSED = 0.05  # of right formulas, that recordings which only judge may refuse
_BEGUN, _LOOKED = 0.2, 0.45  # of the time: to the model's minimum, and to what is seen from there; trials the rest


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
    """The formula that is shipped, as the force over time has it."""
    forms = self.sought.forms if self.sought else None
    return forms.best if forms and self.kind == "formula" else None


def find_formula(
  problem: Problem, winner: Candidate, came: Candidate, priors: ParameterSet, progress: Progress = silent
) -> Found:
  """Look for a formula for what a fitted model leaves over.

  Args:
    problem: with the model's weights.
    winner: the model, fitted to its minimum.
    came: the same where it stood before.
    priors: declarations of the base parameters.
    progress: reports the share that is done.
  """
  with threadpool_limits(1):  # many small matrices: a second thread costs more than it brings
    moved = np.abs(came.values - winner.values) > winner.std  # else it is the same place
    return _found(problem, [winner, came] if moved.any() else [winner], priors, progress)


def _found(problem: Problem, bases: list[Candidate], priors: ParameterSet, progress: Progress) -> Found:
  began, random = time.perf_counter(), np.random.default_rng(0)
  over, looks = lambda: time.perf_counter() - began, []
  for k, base in enumerate(bases):
    span = [_BEGUN + (_LOOKED - _BEGUN) * i / len(bases) for i in (k, k + 1)]
    near, model = stood(problem, base, priors) if k else (problem, base)
    looks.append(look(near, model, random, progress, (span[0], span[1])))
  progress(STAGE, _LOOKED)
  again = lambda near, model: look(*stood(near, model, priors), random)
  won = placed(problem, priors, looks, again)
  if won is not None:
    twin = refitted(problem, bases[0], priors, won.trial, won.where.driven)
    if good(twin):
      same = tuple(n for seen in looks[:1] for n in seen.stands_for.get(won.where.recovered.degree, ()))
      return Found(won.where, tuple(dict.fromkeys((*won.alike, *same))), "formula", "", twin, over())
  if not looks[0].there:
    return Found(None, (), "", "what is left follows nothing that a formula was tried with", None, over())
  best = looks[0].there[0]
  kind, why, tabled = _tabled(problem, bases, priors, best, looks[0].fitted)
  return Found(best, _as_good(looks[0]), kind, why, tabled or (twin if won else None), over())


def _tabled(
  problem: Problem, bases: list[Candidate], priors: ParameterSet, best: Sought, fitted: Fitted
) -> tuple[str, str, Refitted | None]:
  """What goes into the twin where no formula does, a word; why nothing does; and the trial in the simulator."""
  assert best.forms is not None
  if not best.forms.tabled:
    return "", "no formula holds, and no table of one or two variables does", None
  trial = fitted_best(problem, bases, priors, [_table(best, fitted)])
  twin = refitted(problem, bases[0], priors, trial, best.driven)
  if good(twin):
    return "table", "", twin
  return "", "in the simulator it does not predict recordings better that took no part in the fit", twin


def _table(where: Sought, fitted: Fitted) -> Option:
  assert where.forms is not None
  names, stiffness = where.forms.table.names, where.forms.table.stiffness
  heights = table_heights(where.responses, where.driven, fitted, names, stiffness)
  return (*table_of(where.recovered.degree, names, heights, where.driven, stiffness), 0.0)


def good(twin: Refitted) -> bool:
  """Whether a twin with it is better held out, and recordings that only judge, where there are some, do not deny it.

  What it takes off the cost must be worth a word in the simulator, too: seen from a base that is not at its minimum, a
  force may make up for what the base's own parameters can do. The few blocks that judge also judge how far the base has
  moved with the formula, along directions that the driving hardly knows: so they deny it where their mean loss is more
  than chance makes of a right one, by Student's t over blocks.
  """
  before, judged = half_square(twin.before.residual[: twin.before.n_train]), twin.judged
  material = twin.before.cost - twin.model.cost >= MATERIAL * before
  denied = judged is not None and judged.t < float(student.ppf(_REFUSED, max(1, len(judged.blocks) - 1)))
  return material and twin.held_out.gain > 0.0 and not denied


def _as_good(looked: Looked) -> tuple[str, ...]:
  """Other degrees of freedom that explain as much as the first one, as seen from one base."""
  best, *others = looked.there
  alike = [s.recovered.degree for s in others if gain(s) > gain(best) - ALIKE]
  return (*alike, *looked.stands_for.get(best.recovered.degree, ()))
