"""The place where a missing force acts, chosen by the simulator: formulas of several places, each with its own base.

At a base that has taken a force over, a force across the car may explain as much of what is left as the one along it
that is missing. So it is looked for from every base that the parameters may begin at; the best formula of each place is
fitted together with the base it was seen from; and where the best of them has brought the base, it is looked for again,
and the formulas that are seen from there compete.
"""

import dataclasses
from collections.abc import Callable, Sequence

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.formula.looking import ALIKE, Looked, Sought
from calibration.diagnosis.formula.refit import Option, Trial, begun, ended, halved, mechanism_of, without
from calibration.fitting.likelihood import Problem
from qcar_twin.parameters import ParameterSet

Look = Callable[[Problem, Candidate], Looked]


@dataclasses.dataclass(frozen=True)
class Placed:
  """A formula that won over those of other places.

  Attributes:
    trial: it, at the minimum of its cost.
    where: what was seen of its place, from the base that the formula was sought at.
    alike: other places, one of whose formulas came within ALIKE of its cost.
  """

  trial: Trial
  where: Sought
  alike: tuple[str, ...]


def placed(problem: Problem, priors: ParameterSet, looks: Sequence[Looked], look: Look) -> Placed | None:
  """The formula of the lowest cost, whichever its place; None where no base has one in sight.

  Args:
    problem: with the model's weights.
    priors: declarations of the base parameters.
    looks: from every base that the parameters may begin at, the model at its minimum first.
    look: at another base.
  """
  firsts = [(begun(problem, options(problem, s)[0], seen.base, priors), s) for seen in looks for s in written(seen)]
  if not firsts:
    return None
  arrived = halved([trial for trial, _ in firsts])
  again = look(*without(problem, looks[0].base, arrived))
  fresh = [
    (begun(problem, option, again.base, priors), s)
    for k, s in enumerate(written(again))
    for option in options(problem, s, others=k == 0)
  ]
  best = halved([arrived, *(trial for trial, _ in fresh)])
  tried = [*firsts, *fresh]
  where = next(s for trial, s in tried if trial is best)
  close = {s.recovered.degree for trial, s in tried if trial.cost < best.cost + ALIKE} - {where.recovered.degree}
  return Placed(ended(best), where, tuple(sorted(close)))


def written(looked: Looked) -> list[Sought]:
  """Places that have a formula."""
  return [s for s in looked.there if s.forms and s.forms.found]


def options(problem: Problem, where: Sought, others: bool = True) -> list[Option]:
  """The formulas of a place that do about as well, the best first; and `others` of the same variables."""
  assert where.forms is not None
  forms, unit = where.forms, problem.twin.vehicle.motor.unit
  tried = {f.terms: f for f in (forms.best, *forms.rivals, *(forms.siblings if others else ()))}
  return [(*mechanism_of(f, where.driven, unit), sum(g.nats for g in f.groups)) for f in tried.values()]
