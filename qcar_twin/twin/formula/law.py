"""A formula as data: a sum of coefficients times products of operations on variables, within the range it is known in.

  F = sum_k c_k prod_j op_j(variable_j)

A term is written `abs(yaw_rate) * sign(speed)`; it is parsed into the closed sets below, and nothing is ever executed.
"""

import dataclasses
import functools
import re
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.twin.formula.variables import VARIABLES, Variable

Array = NDArray[np.float64]

BEYOND = 1.2  # half-widths of the driven range about its middle to which a variable is followed
_FACTOR = re.compile(r"(?:(?P<operation>\w+)\((?P<inside>\w+)\)|(?P<plain>\w+))")

# of a variable in its unit and the width of its sign, in the same unit
OPERATIONS: dict[str, Callable[[Array, float], Array]] = {
  "value": lambda z, width: z,
  "abs": lambda z, width: np.abs(z),
  "square": lambda z, width: z * z,
  "sign": lambda z, width: np.tanh(z / width),
  "cos": lambda z, width: np.cos(z),
  "sin": lambda z, width: np.sin(z),
  "cos2": lambda z, width: np.cos(2.0 * z),
  "sin2": lambda z, width: np.sin(2.0 * z),
}
POWER = {"value": 1, "abs": 1, "square": 2}  # of the variable's unit that is in an operation's; 0 of all others
TURNING = ("cos", "sin", "cos2", "sin2")


@dataclasses.dataclass(frozen=True)
class Term:
  """A product.

  Attributes:
    factors: (operation, variable) each.
  """

  factors: tuple[tuple[str, str], ...]

  @classmethod
  def parse(cls, text: str) -> "Term":
    """Of a text such as "abs(yaw_rate) * sign(speed)"; "1" is the empty product.

    Raises:
      ValueError: what is not known, and what is.
    """
    factors: list[tuple[str, str]] = []
    if text.strip() == "1":
      return cls(())
    for part in (p.strip() for p in text.split("*")):
      match = _FACTOR.fullmatch(part)
      if match is None:
        raise ValueError(f"'{part}' in '{text}' is no factor; write variable or operation(variable), joined by *")
      operation, variable = match["operation"] or "value", match["inside"] or match["plain"]
      if operation not in OPERATIONS:
        raise ValueError(f"no operation '{operation}' in '{text}'; there are {', '.join(OPERATIONS)}")
      if variable not in VARIABLES:
        raise ValueError(f"no variable '{variable}' in '{text}'; there are {', '.join(VARIABLES)}")
      if VARIABLES[variable].angular != (operation in TURNING):
        fitting = ", ".join(TURNING) if VARIABLES[variable].angular else "value, abs, square or sign"
        raise ValueError(f"{operation}({variable}) in '{text}' has no meaning; of {variable} take {fitting}")
      factors.append((operation, variable))
    return cls(tuple(factors))

  def __str__(self) -> str:
    return " * ".join(v if op == "value" else f"{op}({v})" for op, v in self.factors) or "1"

  @property
  def variables(self) -> frozenset[str]:
    return frozenset(variable for _, variable in self.factors)

  @property
  def equation(self) -> str:
    """In symbols: |r| sgn(v)."""
    return " ".join(_symbolic(op, VARIABLES[v]) for op, v in self.factors)

  @property
  def unit(self) -> dict[str, int]:
    """Powers of units of the product."""
    out: dict[str, int] = {}
    for operation, name in self.factors:
      for base, power in VARIABLES[name].unit.items():
        out[base] = out.get(base, 0) + POWER.get(operation, 0) * power
    return {base: power for base, power in out.items() if power}


def _symbolic(operation: str, variable: Variable) -> str:
  s = variable.symbol
  written = {"value": s, "abs": f"|{s}|", "square": f"{s}^2", "sign": f"sgn({s})", "cos": f"cos({s})",
             "sin": f"sin({s})", "cos2": f"cos(2 {s})", "sin2": f"sin(2 {s})"}  # fmt: skip
  return written[operation]


@dataclasses.dataclass(frozen=True)
class Law:
  """A formula and where it holds.

  Attributes:
    degree: what it acts on, one of DEGREES in degrees.py.
    terms: texts that `Term.parse` reads, one per coefficient.
    ranges: lowest and highest driven value of every variable, in its unit; a little beyond, it is held.
    limit: largest magnitude of the sum, in the degree's unit: 1.2 times the largest in what was driven.
    near: x, y [m] and radius [m] of a place outside which it fades, exp(-d^2 / 2 radius^2); () for everywhere.
  """

  degree: str
  terms: tuple[str, ...]
  ranges: Mapping[str, tuple[float, float]]
  limit: float
  near: tuple[float, ...] = ()

  def __post_init__(self) -> None:
    missing = sorted(self.variables - set(self.ranges))
    if not self.terms:
      raise ValueError(f"a formula of {self.degree} needs a term, such as 'abs(yaw_rate) * sign(speed)'")
    if missing:
      raise ValueError(
        f"the formula of {self.degree} has no range of {', '.join(missing)}: give its lowest and highest"
      )
    if not (np.isfinite(self.limit) and self.limit > 0.0):
      raise ValueError(f"the limit of a formula of {self.degree} must be a positive number, not {self.limit}")

  @functools.cached_property
  def parsed(self) -> tuple[Term, ...]:
    return tuple(map(Term.parse, self.terms))

  @property
  def variables(self) -> frozenset[str]:
    place = frozenset(("place_x", "place_y") if self.near else ())
    return place.union(*(term.variables for term in self.parsed))

  def basis(self, values: Mapping[str, Array], widths: Mapping[str, float]) -> Array:
    """Products, (..., K), of variables (...) in their units; `widths`: of their signs."""
    held = {name: clip_to(values[name], self.ranges[name]) if not VARIABLES[name].angular else values[name]
            for name in self.variables}  # fmt: skip
    return np.stack([product(term, held, widths) for term in self.parsed], axis=-1)


def product(term: Term, values: Mapping[str, Array], widths: Mapping[str, float]) -> Array:
  """One term of variables (...) in their units."""
  out = np.ones_like(next(iter(values.values())))
  for operation, name in term.factors:
    out = out * OPERATIONS[operation](values[name], widths[name])
  return out


def clip_to(value: Array, driven: tuple[float, float]) -> Array:
  """A variable held beyond 1.2 half-widths of the range that was driven."""
  middle, half = 0.5 * (driven[0] + driven[1]), 0.5 * (driven[1] - driven[0])
  return np.clip(value, middle - BEYOND * half, middle + BEYOND * half)
