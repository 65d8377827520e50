"""A simulator that has no parameters to set, such as the independent car, in the shape of a plant."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import ParameterSet
from qcar_twin.plant import Simulation

Array = NDArray[np.float64]


class ExternalPlant:
  """N cars of somebody else's simulator; nothing is fitted to it.

  Args:
    begin: cars at starts (N, 7), see `qcar_twin.plant`.
    period: its control period, s.
  """

  parameters = ParameterSet(())

  def __init__(self, begin: Callable[[Array], Simulation], period: float = 0.01):
    self.period = period
    self._begin = begin

  def begin(self, theta: Array, start: Array) -> Simulation:
    """Cars at starts (N, 7); parameters (N, 0) are not looked at."""
    return self._begin(start)
