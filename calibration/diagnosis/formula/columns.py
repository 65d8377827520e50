"""What a force of some shape would change in the residual, less what the model's own parameters can imitate of that."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.formula.dictionary import Group
from calibration.diagnosis.formula.moments import by_pulse
from calibration.diagnosis.formula.pulses import Responses
from calibration.diagnosis.formula.recovery import Base
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.law import product
from qcar_twin.twin.formula.mechanism import Formula
from qcar_twin.twin.formula.variables import VARIABLES
from qcar_twin.twin.mechanisms.base import CarDimensions

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Driven:
  """The driving as formulas see it.

  Attributes:
    values: every variable at every control period, in its unit, (S, T).
    fade: how much of a force there is that vanishes at rest, (S, T).
    car: the car's numbers.
    period: s.
  """

  values: Mapping[str, Array]
  fade: Array
  car: CarDimensions
  period: float

  def widths(self) -> dict[str, float]:
    """Over which signs turn."""
    scale = lambda name: VARIABLES[name].scale
    return {n: VARIABLES[n].width * (s(self.car) if (s := scale(n)) else float(np.abs(v).max()))
            for n, v in self.values.items()}  # fmt: skip

  def shape_of(self, degree: str, group: Group) -> Array:
    """The terms of a group by pulse, (S, K, terms), in their units."""
    widths = self.widths()
    parts = [product(term, self.values, widths) for term in group.terms]
    if group.near:
      x, y, radius = group.near
      away = (self.values["place_x"] - x) ** 2 + (self.values["place_y"] - y) ** 2
      parts = [part * np.exp(-0.5 * away / radius**2) for part in parts]
    fade = self.fade if DEGREES[degree].fades else 1.0
    return np.stack([by_pulse(part * fade, self.period) for part in parts], axis=-1)


@dataclasses.dataclass(frozen=True)
class Fitted:
  """The values that are fitted, with what a model's parameters can imitate of them taken away.

  Attributes:
    base: the model.
    rest: of the target, (M,).
    group, witness: of every value, (M,): a recording; a second of driving.
  """

  base: Base
  rest: Array
  group: NDArray[np.int64]
  witness: NDArray[np.int64]

  def columns(self, responses: Responses, shapes: Array) -> Array:
    """What shapes (S, K, D), in the degree's unit, would change, (M, D)."""
    out = np.zeros((len(self.rest), shapes.shape[-1]))
    for rows, answer, shape in zip(responses.rows, responses.columns, shapes, strict=True):
      if len(rows) and rows[-1] < len(out):
        out[rows] = answer @ (shape / responses.scale)
    return self.base.without(out)


def said(mechanism: Formula, theta: Sequence[float], driven: Driven) -> Array:
  """A formula at every control period, (S, T), in its degree's unit.

  Args:
    mechanism: the formula.
    theta: of its parameters.
    driven: the driving.
  """
  basis = mechanism.law.basis(driven.values, driven.widths())
  value = basis @ np.asarray(theta[: basis.shape[-1]])
  if len(theta) == basis.shape[-1] + 3:
    x, y, radius = theta[-3:]
    away = (driven.values["place_x"] - x) ** 2 + (driven.values["place_y"] - y) ** 2
    value = value * np.exp(-0.5 * away / radius**2)
  if DEGREES[mechanism.law.degree].fades:
    value = value * driven.fade
  return np.clip(value, -mechanism.law.limit, mechanism.law.limit)
