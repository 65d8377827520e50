"""What a formula says over the driving."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.formula.columns import Driven
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.mechanism import Formula

Array = NDArray[np.float64]


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
