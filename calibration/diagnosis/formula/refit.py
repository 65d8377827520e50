"""A formula in the simulator: fitted there with all of the model's own parameters, and confirmed by MuJoCo."""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate, candidate, refine, simulate
from calibration.diagnosis.formula.columns import Driven, said
from calibration.diagnosis.formula.forms import Form
from calibration.diagnosis.formula.minimum import at_minimum
from calibration.diagnosis.formula.tables import table_knots, table_shapes
from calibration.diagnosis.score import Comparison, clustered_std, compare, compared
from calibration.fitting.likelihood import Problem
from calibration.fitting.surrogate import Surrogate
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.law import BEYOND, Law, Term
from qcar_twin.twin.formula.mechanism import Formula, limited, made
from qcar_twin.twin.formula.table import Table
from qcar_twin.twin.formula.variables import VARIABLES, spell
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]
Option = tuple[Formula, dict[str, float], float]  # a formula, the values it starts from, the nats it takes to say

_STEPS = 3  # of Gauss-Newton with fresh columns, after which the worse half of several formulas is given up
_REACH = 8.0  # times its first value to which a coefficient is followed


@dataclasses.dataclass(frozen=True)
class Refitted:
  """A formula in the simulator.

  Attributes:
    mechanism: the formula.
    problem: with it among the twin's mechanisms, in MuJoCo.
    model: fitted, with MuJoCo's residual.
    before: the model without it, with MuJoCo's residual.
    held_out: gain over that, on what is fitted and on what judges.
    judged: the same on recordings that only judge; None without any.
  """

  mechanism: Formula
  problem: Problem
  model: Candidate
  before: Candidate
  held_out: Comparison
  judged: Comparison | None

  @property
  def theta(self) -> Array:
    return self.model.theta

  @property
  def values(self) -> list[tuple[Parameter, float, float]]:
    """Its parameters with value and standard deviation, by the scatter of recordings as a claim's."""
    std = clustered_std(self.model, self.problem.observations)
    at = [(p, self.model.free.index(p.name)) for p in self.mechanism.parameters]
    return [(p, float(self.model.values[i]), float(std[i])) for p, i in at]


def mechanism_of(form: Form, driven: Driven, unit: str) -> tuple[Formula, dict[str, float]]:
  """A formula as a mechanism, and the values it starts from.

  Args:
    form: of `forms_of`.
    driven: where it holds.
    unit: of the car's drive command.
  """
  name = f"unnamed_{form.degree}"
  names = frozenset().union(*(t.variables for t in form.terms))
  names |= frozenset(("place_x", "place_y") if form.near else ())
  ranges = {n: _range(n, driven) for n in sorted(names)}
  force = sum(c * s for c, s in zip(form.coefficients, _shapes(form, driven), strict=True))
  limit = _REACH * float(np.abs(force).max())  # no hindrance to the fit, which sets it anew
  law = Law(form.degree, tuple(map(str, form.terms)), ranges, limit, form.near)
  parameters = [_coefficient(name, k, float(value), term, unit)
                for k, (value, term) in enumerate(zip(form.coefficients, form.terms, strict=True), 1)]  # fmt: skip
  if form.near:
    parameters += _place(name, form.near, driven)
  start = {p.name: float(v) for p, v in zip(parameters, [*form.coefficients, *form.near], strict=True)}
  return made(name, law, parameters), start


def table_of(
  degree: str, names: Sequence[str], heights: Array, driven: Driven, stiffness: float
) -> tuple[Formula, dict[str, float]]:
  """A table as a mechanism, from heights in the degree's unit, and the values it starts from."""
  name, acts = f"unnamed_{degree}", DEGREES[degree]
  knots, scale = table_knots(driven, names), acts.scale(driven.car)
  force = table_shapes(degree, driven, knots) @ heights
  law = Table(degree, knots, _REACH * float(np.abs(force).max()))
  usual = scale / np.sqrt(stiffness)
  parameters = [
    Parameter(f"{name}_{k}", 0.0, -_REACH * usual, _REACH * usual, acts.unit, f"c_{k}", null=0.0, std=usual,
              typical=usual, description=at)
    for k, at in enumerate(law.terms, 1)
  ]  # fmt: skip
  return made(name, law, parameters), {p.name: float(h) for p, h in zip(parameters, heights, strict=True)}


@dataclasses.dataclass
class Trial:
  """A formula that is fitted with all parameters of the model.

  Attributes:
    mechanism: the formula, not limited yet.
    problem: with it, put right where it stood when it was last compared.
    model: fitted.
    nats: that it takes to say which formula it is.
  """

  mechanism: Formula
  problem: Problem
  model: Candidate
  nats: float

  @property
  def cost(self) -> float:
    """Of the fit, with what it takes to say."""
    return self.model.cost + self.nats


def fitted_best(problem: Problem, bases: Sequence[Candidate], priors: ParameterSet, found: Sequence[Option]) -> Trial:
  """The best of several formulas, fitted with all parameters of the model to the minimum.

  Args:
    problem: with the model's weights.
    bases: the model they are added to, at its minimum; and where else its parameters may begin. At its minimum without
      a formula a base has taken over what it could of the missing force, and the way back may lead over a ridge.
    priors: declarations of the base parameters.
    found: each formula, the values it starts from, and the nats it takes to say.
  """
  return ended(halved([begun(problem, option, base, priors) for option, base in itertools.product(found, bases)]))


def begun(problem: Problem, option: Option, base: Candidate, priors: ParameterSet) -> Trial:
  """A formula added to a base, simulated and not yet fitted; the arguments are those of `fitted_best`."""
  mechanism, start, nats = option
  near = with_formula(problem.at(base.theta), mechanism)
  model = candidate(near, (*base.mechanisms, mechanism.name), base, priors, start)
  simulate(near, [model])
  return Trial(mechanism, near, model, nats)


def halved(trials: Sequence[Trial]) -> Trial:
  """The one of the lowest cost, by successive halving: a few steps each, then the better half goes on.

  What goes on is put right by MuJoCo where it stands: trials that came from afar are compared by their own cost, and
  not by a correction that belongs elsewhere. Each one keeps the cost it came to, also where it is given up.
  Source: Jamieson and Talwalkar, Non-stochastic best arm identification and hyperparameter optimization, AISTATS 2016.
  """
  while True:
    for trial in trials:
      trial.model.settled = False
      refine(trial.problem, [trial.model], _STEPS, full=True)
    trials = sorted(trials, key=lambda trial: trial.cost)[: max(1, len(trials) // 2)]
    if len(trials) == 1:
      return trials[0]
    for trial in trials:
      trial.problem = trial.problem.at(trial.model.theta)
      simulate(trial.problem, [trial.model])


def ended(trial: Trial) -> Trial:
  """A trial at its minimum."""
  near, model = at_minimum(trial.problem, trial.model)
  return Trial(trial.mechanism, near, model, trial.nats)


def without(problem: Problem, winner: Candidate, trial: Trial) -> tuple[Problem, Candidate]:
  """The model without a formula where the formula brought its parameters, full of what it can't explain there."""
  values = trial.model.values[[trial.model.free.index(name) for name in winner.free.names]]
  theta = problem.embed(winner.free.names, values, problem.parameters.nominal)[0]
  there = problem.at(theta)
  columns = [trial.model.free.index(name) for name in winner.free.names]
  moved = dataclasses.replace(winner, theta=theta, values=values, residual=there.residual(theta[None])[0],
                              jacobian=trial.model.jacobian[:, columns])  # fmt: skip
  return there, moved


def refitted(problem: Problem, winner: Candidate, priors: ParameterSet, trial: Trial, driven: Driven) -> Refitted:
  """A formula in MuJoCo, held against the model without it.

  That model is at its own minimum: where it stood, or the one near where the formula brought its parameters, so that
  no formula is paid for a valley that the model alone had missed.

  Args:
    problem: with the model's weights.
    winner: the model without a formula, at its minimum.
    priors: declarations of the base parameters.
    trial: the formula, fitted.
    driven: the driving, from which the force's limit is.
  """
  _, other = at_minimum(*without(problem, winner, trial))
  lowest = min(winner, other, key=lambda m: m.cost)
  before = candidate(trial.problem.exact, winner.mechanisms, lowest, priors)
  before.residual = lowest.residual
  theta = [trial.model.values[trial.model.free.index(p.name)] for p in trial.mechanism.parameters]
  mechanism = limited(trial.mechanism, BEYOND * float(np.abs(said(trial.mechanism, theta, driven)).max()))
  exact, model = with_formula(problem, mechanism).exact, dataclasses.replace(trial.model)
  simulate(exact, [model])
  n, observations = model.n_train, problem.observations
  judges = n < len(model.residual)
  judged = compared(model.residual[n:], before.residual[n:], observations.block[n:]) if judges else None
  return Refitted(mechanism, exact, model, before, compare(model, before, observations), judged)


def with_formula(problem: Problem, mechanism: Formula) -> Problem:
  """The same problem with a formula among the twin's mechanisms, at its null."""
  old = problem.twin
  if isinstance(old, Surrogate):
    exact = _added(old.exact, mechanism)
    anchor = None if old.anchor is None else _carried(old, exact, old.anchor)
    twin: Twin = Surrogate(exact, anchor, old.guarded)
  else:
    twin = _added(old, mechanism)
  return Problem(twin, problem.observations, problem.weighting, problem.n_train, problem.base)


def _added(twin: Twin, mechanism: Formula) -> Twin:
  return twin.with_mechanisms([*twin.mechanisms, mechanism])


def _carried(old: Twin, new: Twin, theta: Array) -> Array:
  """A parameter vector for a twin with one mechanism more."""
  out = new.parameters.nominal
  out[[new.parameters.index(p.name) for p in old.parameters]] = theta
  return out


def _shapes(form: Form, driven: Driven) -> list[Array]:
  return [part for g in form.groups for part in np.moveaxis(driven.shape_of(form.degree, g), -1, 0)]


def _range(name: str, driven: Driven) -> tuple[float, float]:
  if VARIABLES[name].angular:
    return -np.pi, np.pi
  low, high = np.quantile(driven.values[name], [0.001, 0.999])
  return float(low), float(high)


def _coefficient(name: str, k: int, value: float, term: Term, unit: str) -> Parameter:
  size = abs(value) or 1e-9
  powers = dict(DEGREES[name.removeprefix("unnamed_")].units)
  for base, power in term.unit.items():
    powers[base] = powers.get(base, 0) - power
  return Parameter(f"{name}_{k}", 0.0, -_REACH * size, _REACH * size, spell(powers, unit), f"c_{k}", null=0.0,
                   std=2.0 * size, typical=size, description=f"of {term.equation or '1'}")  # fmt: skip


def _place(name: str, near: tuple[float, ...], driven: Driven) -> list[Parameter]:
  x, y, radius = near
  reach = 2.0 * radius
  make = lambda part, value, low, high, what: Parameter(
    f"{name}_{part}", value, low, high, "m", part, std=0.5 * radius, description=what
  )
  return [make("x", x, x - reach, x + reach, "of the spot"), make("y", y, y - reach, y + reach, "of the spot"),
          make("radius", radius, 0.2 * radius, 4.0 * radius, "of the spot")]  # fmt: skip
