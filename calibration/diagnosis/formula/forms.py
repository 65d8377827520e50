"""What a degree of freedom's missing force is a function of: a formula, and a table to hold it against."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from calibration.diagnosis.formula.columns import Driven, Fitted
from calibration.diagnosis.formula.dictionary import Group, groups
from calibration.diagnosis.formula.moments import by_pulse
from calibration.diagnosis.formula.pulses import Responses
from calibration.diagnosis.formula.selection import (
  ENOUGH,
  Chosen,
  Grams,
  by_chance,
  held_out,
  rivals,
  shortest,
  siblings,
  solved,
  stability,
  stepwise,
)  # fmt: skip
from calibration.diagnosis.formula.tables import TableFit, best_table
from qcar_twin.twin.formula.law import Term

Array = NDArray[np.float64]

_LIKELY = 0.6  # share of halves that must agree: Meinshausen and Buehlmann's bound holds from one half on
_CHANCE = 0.02  # family-wise, of everything that is offered to one log
MATERIAL = 0.04  # of the squared error that is left: 2 % of the error
HOLDS = 0.8  # of the table's held-out gain, that a formula must hold
_RIVALS = 4
_INVISIBLE = 1e-3  # nats^(1/2) that a term shows at the size of the degree's scale


@dataclasses.dataclass(frozen=True)
class Form:
  """A formula of one degree of freedom.

  Attributes:
    degree: where it acts.
    groups: of terms.
    coefficients, std: of all their terms in turn, in their units.
    gain: held out, nats.
  """

  degree: str
  groups: tuple[Group, ...]
  coefficients: Array
  std: Array
  gain: float

  @property
  def variables(self) -> tuple[str, ...]:
    return tuple(sorted(frozenset().union(*(g.variables for g in self.groups))))

  @property
  def terms(self) -> tuple[Term, ...]:
    return tuple(term for g in self.groups for term in g.terms)

  @property
  def near(self) -> tuple[float, ...]:
    """The spot it is tied to, () for none."""
    return next((g.near for g in self.groups if g.near), ())


@dataclasses.dataclass(frozen=True)
class Forms:
  """What a degree of freedom's missing force may be.

  Attributes:
    best: the formula.
    rivals: formulas of one group that do as well, to a twentieth.
    siblings: other formulas of the same variables as the first group's.
    stable: share of halves of the data whose first group depends on the same variables as one of these.
    chance: probability of a term as good by chance.
    table: the best one.
    rest: nats that the model leaves, half the sum of squares.
  """

  best: Form
  rivals: tuple[Form, ...]
  siblings: tuple[Form, ...]
  stable: float
  chance: float
  table: TableFit
  rest: float

  @property
  def gain(self) -> float:
    """Of the formula or of the table, whichever is more, nats."""
    return max(self.best.gain, self.table.gain)

  @property
  def there(self) -> bool:
    """Whether something is there that is neither chance nor immaterial."""
    return self.written or self.tabled

  @property
  def written(self) -> bool:
    """The same of a formula."""
    return self.chance < _CHANCE and self.best.gain >= self.material

  @property
  def tabled(self) -> bool:
    """The same of a table."""
    return self.table.chance < _CHANCE and self.table.gain >= self.material

  @property
  def material(self) -> float:
    """Nats below which a gain is not worth a word."""
    return MATERIAL * self.rest

  @property
  def found(self) -> bool:
    """Whether it has a formula, and not only a table."""
    return self.written and self.stable >= _LIKELY and self.best.gain >= HOLDS * self.table.gain


def forms_of(responses: Responses, driven: Driven, fitted: Fitted, random: np.random.Generator) -> Forms | None:
  """The formulas of a degree of freedom; None where nothing is worth its coefficients."""
  degree = responses.degree
  known = {name: by_pulse(value, driven.period) for name, value in driven.values.items()}
  offered = groups(degree, known)
  columns, size, owner = _columns(responses, driven, fitted, offered)
  grams = Grams.of(columns, fitted.rest, fitted.group, owner)
  steps = stepwise(grams, offered)
  if not steps:
    return None
  best = shortest(steps)
  near = [offered[j].near for j in best.members if offered[j].near]
  if near:  # the floor is searched on a grid; a spot found there is put where it fits best, and stands alone
    spot = _centred(responses, driven, fitted, offered[next(j for j in best.members if offered[j].near)])
    others = [offered[j] for j in best.members if not offered[j].near]
    return _of_a_spot(responses, driven, fitted, (spot, *others), columns, random)
  alike = rivals(grams, offered, best, _RIVALS)
  wanted = [offered[c.members[0]].variables for c in alike]
  form = lambda chosen: _form(degree, grams, chosen, [offered[j] for j in chosen.members], size)
  return Forms(
    form(best),
    tuple(form(c) for c in alike),
    tuple(form(c) for c in siblings(grams, offered, best, _RIVALS)),
    stability(grams, offered, wanted, random),
    by_chance(columns, fitted.rest, fitted.group, fitted.witness, random),
    best_table(responses, driven, fitted, random),
    0.5 * float(fitted.rest @ fitted.rest),
  )


def _columns(
  responses: Responses, driven: Driven, fitted: Fitted, offered: Sequence[Group]
) -> tuple[Array, Array, NDArray[np.int64]]:
  """Columns (M, D) of all terms at a root mean square of one, that root mean square, and the group each belongs to."""
  shapes = [driven.shape_of(responses.degree, g) for g in offered]
  owner = np.repeat(np.arange(len(offered)), [s.shape[-1] for s in shapes])
  stacked = np.concatenate(shapes, axis=-1)
  size = np.sqrt(np.mean(stacked**2, axis=(0, 1))) + 1e-12
  columns = fitted.columns(responses, stacked / size * responses.scale)
  columns[:, np.linalg.norm(columns, axis=0) < _INVISIBLE] = 0.0
  return columns, size / responses.scale, owner


def _form(degree: str, grams: Grams, chosen: Chosen, groups_in: Sequence[Group], size: Array) -> Form:
  at = np.concatenate([grams.columns((j,)) for j in chosen.members])
  value, std = solved(grams, at)
  return Form(degree, tuple(groups_in), value / size[at], std / size[at], chosen.gain)


def _centred(responses: Responses, driven: Driven, fitted: Fitted, group: Group) -> Group:
  """A spot where it explains most."""

  def lost(place: Array) -> float:
    trial = Group(group.terms, (place[0], place[1], abs(place[2]) + 1e-3))
    column = fitted.columns(responses, driven.shape_of(responses.degree, trial))
    pull, power = column.T @ fitted.rest, np.sum(column**2)
    return -float(np.sum(pull**2)) / (float(power) + 1e-12)

  step = group.near[2] * np.eye(3) * 0.5
  start = np.array(group.near)
  options = {"initial_simplex": np.vstack([start, start + step]), "maxfev": 60, "xatol": 0.01}
  found = minimize(lost, start, method="Nelder-Mead", options=options)
  x, y, radius = found.x
  return Group(group.terms, (float(x), float(y), float(abs(radius) + 1e-3)))


def _of_a_spot(
  responses: Responses,
  driven: Driven,
  fitted: Fitted,
  made: tuple[Group, ...],
  offered: Array,
  random: np.random.Generator,
) -> Forms:
  columns, size, owner = _columns(responses, driven, fitted, made)
  grams = Grams.of(columns, fitted.rest, fitted.group, owner)
  alone = _form_of_all(responses.degree, grams, made[:1], size)
  whole = _form_of_all(responses.degree, grams, made, size)
  best = alone if alone.gain >= ENOUGH * whole.gain or len(made) == 1 else whole
  chance = by_chance(np.hstack([offered, columns]), fitted.rest, fitted.group, fitted.witness, random)
  return Forms(
    best,
    (best,),
    (),
    1.0,
    chance,
    best_table(responses, driven, fitted, random),
    0.5 * float(fitted.rest @ fitted.rest),
  )


def _form_of_all(degree: str, grams: Grams, made: tuple[Group, ...], size: Array) -> Form:
  members = tuple(range(len(made)))
  gains = held_out(grams, grams.columns(members))
  return _form(degree, grams, Chosen(members, gains), made, size)
