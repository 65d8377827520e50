"""What a car remembers of its drive: slow means of steering command and path curvature.

A linkage that the filter does not know bends its estimate within about a second; command and curvature, averaged
over that time, give it away.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MEMORY = 1.0  # s, time constant of the means


def remember(past: Array, steering: Array, curvature: Array, period: float) -> Array:
  """The means a period later: first-order lags, d(past)/dt = (now - past) / MEMORY.

  Args:
    past: of steering command and curvature, rad and 1/m, (N, 2); zero when a drive begins.
    steering: last command, rad, (N,).  curvature: of the path at the car, 1/m, (N,).
    period: s.
  """
  return past + period / MEMORY * (np.stack([steering, curvature], axis=-1) - past)
