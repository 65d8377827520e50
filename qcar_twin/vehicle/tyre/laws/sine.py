"""Pacejka's sine law: the force rises to a peak and falls a little beyond it.

Equation: g(rho) = sin(C atan(rho / C)) / rho.
Source: Pacejka, Tyre and Vehicle Dynamics, 3rd ed., 2012, ch. 4.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import Parameter

PARAMETERS = (Parameter("tyre_shape", 1.4, 1.0, 1.95, "-", "C", std=0.2),)  # 1 has no fall after the peak


def slip_over_linear(used: NDArray[np.float64], values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
  """Steady slip over that of a linear tyre, rho / (rho g), below the peak: rho = C tan(asin(rho g) / C).

  Args:
    used: force in units of mu F_z, rho g, (N,), 0 to 1.
    values: parameters of the law by name, (N,) each.
  """
  used, shape = np.maximum(used, 1e-4), values["tyre_shape"]
  return shape * np.tan(np.arcsin(used) / shape) / used
