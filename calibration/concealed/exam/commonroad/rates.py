"""The package's right-hand side with tyres that slip where they touch the road.

The package takes their slip angles from the side speed of the sprung mass, whose centre of gravity swings above the
road as the car rolls. So a body that rolls to the left would pull its tyres to the left. Its own states have the side
speed of each unsprung mass, v_u; with that, and the roll rate w_u of the axle at the height h of its centre,

    alpha = atan((v_u - h w_u) / v_w) - delta

with the speed v_w of the wheel's centre along the car. All else is the package's own function, whose calls for a tyre's
force come here first.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan
from types import FunctionType
from typing import Any

from ..generator import load_package

_TYRES = 4  # in the package's order: front left, front right, rear left, rear right


class Rates:
  """rates(state, (steering rate, acceleration), parameters) returns the 29 rates; raises as `load_package`."""

  def __init__(self) -> None:
    package = load_package("vehiclemodels.vehicle_dynamics_mb", "commonroad-vehicle-models")
    own = package.vehicle_dynamics_mb
    self._tyres, self._shifts, self._asked = package.tireModel, [0.0] * _TYRES, [0, 0, 0]
    self._rates = FunctionType(own.__code__, {**own.__globals__, "tireModel": self})

  def __call__(self, x: list[float], command: Sequence[float], p: Any) -> list[float]:
    self._shifts, self._asked = slip_shifts(x, p), [0, 0, 0]
    return self._rates(x, command, p)

  def formula_longitudinal(self, kappa: float, gamma: float, load: float, tyre: Any) -> float:
    """The package's."""
    return self._tyres.formula_longitudinal(kappa, gamma, load, tyre)

  def formula_lateral(self, alpha: float, gamma: float, load: float, tyre: Any) -> list[float]:
    """The package's at the tyre's own slip angle; so are the next two."""
    return self._tyres.formula_lateral(alpha + self._next(0), gamma, load, tyre)

  def formula_longitudinal_comb(self, kappa: float, alpha: float, force: float, tyre: Any) -> float:
    """Of combined slip, along."""
    return self._tyres.formula_longitudinal_comb(kappa, alpha + self._next(1), force, tyre)

  def formula_lateral_comb(
    self, kappa: float, alpha: float, gamma: float, grip: float, load: float, force: float, tyre: Any
  ) -> float:
    """Of combined slip, across."""
    return self._tyres.formula_lateral_comb(kappa, alpha + self._next(2), gamma, grip, load, force, tyre)

  def _next(self, formula: int) -> float:
    """The shift of the tyre whose turn it is with a formula."""
    tyre = self._asked[formula]
    self._asked[formula] = tyre + 1
    return self._shifts[tyre]


def slip_shifts(x: Sequence[float], p: Any) -> list[float]:
  """What the tyres' slip angles are more than the package has them, rad."""
  axles = (
    (x[10] + p.a * x[5], x[15], x[14] * (p.R_w - x[16]), 0.5 * p.T_f),
    (x[10] - p.b * x[5], x[20], x[19] * (p.R_w - x[21]), 0.5 * p.T_r),
  )
  return [
    atan((own - rolling) / (x[3] + side * x[5])) - atan((body - rolling) / (x[3] + side * x[5]))
    for body, own, rolling, aside in axles
    for side in (aside, -aside)
  ]
