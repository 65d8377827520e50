"""A characterised twin as one model among others: what is tried beside it, in its place or without it.

The twin's slopes serve for every model near it: only what a model has of its own is simulated anew, and all of a round
share their simulations (calibration/diagnosis/candidates.py).
"""

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from scipy.stats import norm

from calibration.diagnosis.candidates import Candidate, candidate, refine, simulate
from calibration.diagnosis.curves.flexible import DELAYS, Characterised, opened
from calibration.diagnosis.curves.naming.bounds import as_wide, widened, with_room
from calibration.diagnosis.curves.naming.forms import Form
from calibration.diagnosis.score import clustered_std, compare
from calibration.fitting.likelihood import Problem
from calibration.fitting.recalibration import reweighted, settled
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.twin.mechanisms import offered, select

MATERIAL = 0.01  # of the errors: what makes less of a difference nobody misses
_KEPT = 3  # models of a round that are fitted to the end


@dataclasses.dataclass(frozen=True)
class Test:
  """A simpler model against a richer one, on driving that neither was fitted to.

  Attributes:
    t: what the richer one gains, mean over spread of blocks of driving.
    nats: that gain.
    worse: the simpler one's error over the richer one's, root mean square of all channels as they are weighted.
  """

  t: float
  nats: float
  worse: float

  @property
  def chance(self) -> float:
    """How often chance gains as much."""
    return float(norm.sf(self.t))

  @property
  def p_value(self) -> float:
    """The same; 1 where the error grows by less than what matters."""
    return self.chance if self.worse > 1.0 + MATERIAL else 1.0


def tested(simpler: Candidate, richer: Candidate, problem: Problem) -> Test:
  """On recordings that only judge, and on what each group of the others gains along the line fitted to the rest."""
  found = compare(richer, simpler, problem.observations)
  # not of capped gains: what is worse without bound, as a model that flies apart, would pass for next to no loss
  left = found.before - sum(found.blocks)
  return Test(found.t, found.total, float(np.sqrt(found.before / max(left, 1e-12 * found.before))))


def borne(simpler: Candidate, trials: "Trials") -> float:
  """How often chance makes as much as a model in the twin's place lacks, against the twin as it is and against the one
  with all maps free, the less often. Of a chain of names each may pass for as good as the twin before it, and the last
  one be far from the first."""
  return min(tested(simpler, richer, trials.problem).p_value for richer in (trials.base, trials.freest))


@dataclasses.dataclass(frozen=True)
class Trials:
  """A characterised twin that models are tried against.

  Attributes:
    problem: residuals of a twin with the whole catalogue, weighted by what the characterised twin leaves.
    base: that twin as a model.
    found: what it came from; curves, beside, forms: what is in it by now; clock: the age that counts as zero.
    freest: that twin with all its maps free, before any was named.
  """

  problem: Problem
  base: Candidate
  found: Characterised
  curves: tuple[str, ...]
  beside: tuple[str, ...]
  clock: str
  freest: Candidate
  forms: tuple[str, ...] = ()

  @classmethod
  def of(cls, found: Characterised) -> "Trials":
    old = found.fitted.problem
    names = dict.fromkeys(m.name for m in (*old.twin.mechanisms, *offered(old.twin.vehicle.drive)))
    twin = old.exact.twin.with_mechanisms(select(names))
    weighting = reweighted(found.fitted).weighting
    problem = Problem(twin, old.observations, weighting, old.n_train, found.fitted.fit.parameters.names)
    base = candidate(problem, (), None, found.fitted.fit.parameters)
    base.values = found.fitted.fit.theta.copy()
    base.theta = problem.embed(base.free.names, base.values, problem.parameters.nominal)[0]
    channel = old.observations.channel
    base.jacobian = found.fitted.jacobian * (weighting.scale(channel) / old.weighting.scale(channel))[:, None]
    simulate(problem, [base])
    refine(problem, [base], 2)
    return cls(problem, base, found, found.curves, found.beside, found.clock, base)

  def model(
    self, forms: Sequence[str] = (), start: Mapping[str, float] | None = None, without: Collection[str] = ()
  ) -> Candidate:
    """The base with mechanisms more, from first values, and without some parameters, which go to their null.

    Delays are counted from where the commands were moved to, so theirs is the lead. A parameter that every car has goes
    back to what was measured of it, where a form had freed it.
    """
    kept = [name for name in self.forms if not set(without) & {p.name for p in self.problem.mechanism(name).parameters}]
    measured = [p for p in self._every_car if p.name in without]
    rest = ParameterSet([*(p for p in self.base.free if p.name not in without), *measured])
    made = candidate(self.problem, (*kept, *forms), self.base, rest, dict(start or {}))
    made.free = ParameterSet([opened(p) for p in made.free])
    as_wide(made, self.base, self.problem)
    for name in set(without) & set(DELAYS):
      made.theta[self.problem.parameters.index(name)] = self.found.lead
    return made

  @property
  def _shifted(self) -> set[str]:
    """Mechanisms that sessions have shifts of: the twin keeps them, at null where it does without."""
    twin = self.found.fitted.problem.twin
    return {m.name for m in twin.mechanisms if {p.name for p in m.parameters} & set(twin.sessions.std)}

  @property
  def _every_car(self) -> list[Parameter]:
    """What is fitted whatever stands beside it or in a curve's place; sessions' shifts go with what they are of."""
    named = {*self.found.curves, *self.found.beside, *self.beside}
    theirs = {p.name for name in named for p in self.problem.mechanism(name).parameters}
    return [p for p in self.found.fitted.fit.parameters if p.name not in theirs and "@" not in p.name]

  def going_on_from(self, chosen: Candidate, without: str = "") -> "Trials":
    """The same with another base, which may do without a curve."""
    kept = tuple(name for name in self.curves if name != without)
    return dataclasses.replace(self, base=chosen, curves=kept, forms=chosen.mechanisms)

  def left_out(self, chosen: Candidate, names: Collection[str]) -> "Trials":
    """The same with a base that does without some of what stood beside the curves or joined them."""
    kept = tuple(name for name in self.beside if name not in names)
    return dataclasses.replace(self, base=chosen, beside=kept, forms=chosen.mechanisms)

  def settled(self) -> Characterised:
    """The base as a characterised twin, fitted to its minimum, with no mechanism that it does without."""
    gone = {*self.found.curves, *self.found.beside} - {*self.curves, *self.beside} - self._shifted
    have = [m.name for m in self.found.fitted.problem.twin.mechanisms if m.name not in gone]
    twin = self.problem.exact.twin.with_mechanisms(select(dict.fromkeys((*have, *self.beside, *self.forms))))
    free = self.base.free
    smaller = Problem(twin, self.problem.observations, self.problem.weighting, self.problem.n_train, free.names)
    fitted = settled(smaller, self.found.fitted.noise_models, free, self.base.values, self.found.fitted.command_shift)
    fitted = with_room(fitted, self.forms)
    return Characterised(fitted, self.curves, self.beside, self.clock, self.forms)


def fitted_form(names: tuple[str, ...], fitted: Candidate, test: Test, trials: Trials) -> Form:
  """Mechanisms as a refitted twin has them, with what the twin that they were set against is worth against it."""
  return Form(names, *sizes_of(names, fitted, trials.problem), test.worse, borne(fitted, trials))


def sizes_of(names: Sequence[str], model: Candidate, problem: Problem) -> tuple[dict[str, float], dict[str, float]]:
  """Values and deviations of mechanisms' parameters in a fitted model, by name."""
  at = {p.name: model.free.index(p.name) for name in names for p in problem.mechanism(name).parameters}
  values, std = (
    {n: float(x[i]) for n, i in at.items()} for x in (model.values, clustered_std(model, problem.observations))
  )
  return values, std


def fit_together(problem: Problem, models: Sequence[Candidate], plainest: Candidate | None = None) -> list[Candidate]:
  """Models fitted, the best of them with all their slopes anew; all of them, best first.

  Args:
    problem: residuals.
    models: not yet simulated.
    plainest: one of them that all others contain: it is fitted to the end, too, from the best place that any of them
      found, lest what is there by accident of the search be taken for theirs.
  """
  simulate(problem, models)
  refine(problem, models, 3)
  last = sorted((m for m in models if m is not plainest), key=lambda m: m.cost)[:_KEPT]
  if plainest is not None:
    _move_to_best(problem, plainest, last)
    last.append(plainest)
  for item in last:
    item.settled = False
  refine(problem, last, 1, full=True)
  again = [item for item in last if widened(problem, item)]
  for item in again:
    item.settled = False
  refine(problem, again, 2, full=True)
  return sorted(models, key=lambda m: m.cost)


def _move_to_best(problem: Problem, plainest: Candidate, others: Sequence[Candidate]) -> None:
  """Put a model where others ended, in what it shares with them, if it costs less there."""
  moved = []
  for other in others:
    values = np.array([other.values[other.free.index(name)] for name in plainest.free.names])
    # what the plainest is measured to within, another may have freed
    values = np.clip(values, plainest.free.lower, plainest.free.upper)
    theta = problem.embed(plainest.free.names, values, plainest.theta)[0]
    moved.append(dataclasses.replace(plainest, values=values, theta=theta))
  simulate(problem, moved)
  best = min([plainest, *moved], key=lambda m: m.cost)
  plainest.values, plainest.theta, plainest.residual = best.values, best.theta, best.residual
