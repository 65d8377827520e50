"""A formula in the simulator: fitted there with all of the model's own parameters, and confirmed by MuJoCo."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate, candidate, half_square, refine, simulate
from calibration.diagnosis.formula.columns import Driven
from calibration.diagnosis.formula.forms import Form
from calibration.diagnosis.formula.tables import table_knots, table_shapes
from calibration.diagnosis.score import Comparison, compare
from calibration.fitting.likelihood import Problem
from calibration.fitting.surrogate import Surrogate
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.law import BEYOND, Law, Term
from qcar_twin.twin.formula.mechanism import Formula, made
from qcar_twin.twin.formula.table import Table
from qcar_twin.twin.formula.variables import VARIABLES, spell
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

_STEPS = 3  # of Gauss-Newton with fresh columns
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
    judged: nats by which it lies closer to recordings that only judge; 0 without any.
  """

  mechanism: Formula
  problem: Problem
  model: Candidate
  before: Candidate
  held_out: Comparison
  judged: float

  @property
  def theta(self) -> Array:
    return self.model.theta

  @property
  def values(self) -> list[tuple[Parameter, float, float]]:
    """Its parameters with value and standard deviation."""
    return [(p, *self.model.estimate(p.name)) for p in self.mechanism.parameters]


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
  law = Law(form.degree, tuple(map(str, form.terms)), ranges, BEYOND * float(np.abs(force).max()), form.near)
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
  law = Table(degree, knots, BEYOND * float(np.abs(force).max()))
  usual = scale / np.sqrt(stiffness)
  parameters = [
    Parameter(f"{name}_{k}", 0.0, -_REACH * usual, _REACH * usual, acts.unit, f"c_{k}", null=0.0, std=usual,
              typical=usual, description=at)
    for k, at in enumerate(law.terms, 1)
  ]  # fmt: skip
  return made(name, law, parameters), {p.name: float(h) for p, h in zip(parameters, heights, strict=True)}


def refitted(
  problem: Problem, winner: Candidate, priors: ParameterSet, found: Sequence[tuple[Formula, dict[str, float], float]]
) -> Refitted:
  """The best of several formulas of one degree of freedom, each fitted with all parameters of the model.

  Args:
    problem: with the model's weights.
    winner: the model they are added to.
    priors: declarations of the base parameters.
    found: each formula, the values it starts from, and the nats it takes to say.
  """
  trials = []
  for mechanism, start, said in found:
    near = with_formula(problem.at(winner.theta), mechanism)
    model = candidate(near, (*winner.mechanisms, mechanism.name), winner, priors, start)
    simulate(near, [model])
    refine(near, [model], _STEPS, full=True)
    trials.append((model.cost + said, mechanism, near, model))
  _, mechanism, near, model = min(trials, key=lambda trial: trial[0])
  exact = near.exact
  before = candidate(exact, winner.mechanisms, winner, priors)
  before.residual = problem.exact.residual(winner.theta[None])[0]
  simulate(exact, [model])
  n = model.n_train
  judged = half_square(before.residual[n:]) - half_square(model.residual[n:])
  return Refitted(mechanism, exact, model, before, compare(model, before, problem.observations), judged)


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
