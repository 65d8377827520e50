"""What a missing force may look like: groups of terms in the variables a log has.

A group is chosen or left as a whole: a product of two operations, both harmonics of an angle, a spot on the floor. A
force along the car that does not change its sign with the motion's direction is offered both as it is and times the
direction of travel, which makes it a resistance.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.law import Term
from qcar_twin.twin.formula.variables import VARIABLES

Array = NDArray[np.float64]

_PRESENT = ("speed", "yaw_rate", "accel_x", "accel_y", "steering", "drive")
_ALONG = ("force_x", "motor_torque")
TRAVEL = ("sign", "speed")
_OPERATIONS = 4  # value, magnitude, square, sign
_SPOTS, _RADII = 7, (0.5, 1.0, 2.0)  # per side of the floor that was driven; radii in steps between them


@dataclasses.dataclass(frozen=True)
class Group:
  """Terms that go together.

  Attributes:
    terms: products.
    near: x, y, radius [m] of a spot, () for everywhere.
  """

  terms: tuple[Term, ...]
  near: tuple[float, ...] = ()

  @property
  def variables(self) -> frozenset[str]:
    """Those that say what it depends on; the direction of travel is no dependence."""
    factors = {v for term in self.terms for op, v in term.factors if (op, v) != TRAVEL}
    return frozenset(factors) | (frozenset(("place_x", "place_y")) if self.near else frozenset())

  @property
  def nats(self) -> float:
    """What it takes to say which group it is, of what is offered: ln(variables x operations) per factor, and the
    logarithms of a grid's points and radii of a spot (Rissanen, Modeling by shortest data description, Automatica 14,
    1978). The direction of travel is free."""
    factors = sum((op, v) != TRAVEL for op, v in self.terms[0].factors)
    spot = np.log(_SPOTS**2 * len(_RADII)) if self.near else 0.0
    return float(factors * np.log(len(_PRESENT) * _OPERATIONS) + spot)


def groups(degree: str, known: Mapping[str, Array]) -> list[Group]:
  """What is offered for a degree of freedom.

  Args:
    degree: one of DEGREES.
    known: variables that there are, over the driving, (S, K).
  """
  usable = [name for name in known if DEGREES[degree].signal == "" or VARIABLES[name].needs == "signals"]
  out: dict[Group, None] = {}
  for factors in _products(usable):
    for made in _signed(degree, Term(factors)):
      out.setdefault(Group((made,)))
  for angle in (name for name in usable if VARIABLES[name].angular):
    for pair in (("cos", "sin"), ("cos2", "sin2")):
      for travel in _directions(degree):
        out.setdefault(Group(tuple(Term(((op, angle), *travel)) for op in pair)))
  if {"place_x", "place_y"} <= set(usable):
    for spot in _spots(known):
      for travel in _directions(degree):
        out.setdefault(Group((Term(travel),), spot))
  return list(out)


def _products(usable: list[str]) -> Iterator[tuple[tuple[str, str], ...]]:
  """Single variables, their products, and what the last seconds leave times what is felt now."""
  present = [name for name in _PRESENT if name in usable]
  for name in present:
    yield (("value", name),)
    yield (("abs", name),)
    yield (("value", name), ("abs", name))
    yield (("square", name),)
  for one, other in itertools.combinations(present, 2):
    for a, b in itertools.product(("value", "abs", "sign"), repeat=2):
      if (a, b) != ("sign", "sign"):
        yield ((a, one), (b, other))
  for name in (n for n in usable if VARIABLES[n].memory):
    yield (("value", name),)
    for felt in present:
      yield (("value", name), ("value", felt))


def _directions(degree: str) -> tuple[tuple[tuple[str, str], ...], ...]:
  return ((TRAVEL,), ()) if degree in _ALONG else ((),)


def _signed(degree: str, term: Term) -> Iterator[Term]:
  """The term; along the car, what is even in the motion's direction also as a resistance, which comes first."""
  if degree in _ALONG and not any(v == "speed" and op in ("value", "sign") for op, v in term.factors):
    yield Term((*term.factors, TRAVEL))
  yield term


def _spots(known: Mapping[str, Array]) -> Iterator[tuple[float, float, float]]:
  """Centres and radii over the floor that was driven."""
  axes, step = [], []
  for name in ("place_x", "place_y"):
    low, high = np.quantile(known[name], [0.02, 0.98])
    axes.append(np.linspace(low, high, _SPOTS))
    step.append((high - low) / (_SPOTS - 1))
  for radius, x, y in itertools.product(_RADII, *axes):
    yield float(x), float(y), float(radius * max(np.mean(step), 1e-3))
