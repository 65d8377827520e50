"""What a car remembers of its last second, value by value: errors, steering command, curvature of the path.

`slow_means` is the same in two numbers. A linkage that the filter does not know bends its estimate within about
`slow_means.MEMORY`; what happened longer ago says nothing more.
"""

import numpy as np
from numpy.typing import NDArray

from qcar_twin.slow_means import MEMORY

Array = NDArray[np.float64]
REMEMBERED = ("cross_track_error m", "heading_error rad", "steering_command rad", "curvature 1/m")


class Recent:
  """A ring of the last MEMORY s of N cars.

  Args:
    now: of REMEMBERED, as the cars begin, (N, 4): what was before counts as this.
    period: s.
  """

  def __init__(self, now: Array, period: float):
    self._period, self._newest = period, 0
    self._rows = np.repeat(now[None], round(MEMORY / period) + 1, axis=0)

  def add(self, now: Array) -> None:
    """A period later, (N, 4)."""
    self._newest = (self._newest + 1) % len(self._rows)
    self._rows[self._newest] = now

  def restart(self, which: NDArray[np.bool_], now: Array) -> None:
    """Some cars, (N,), begin again, with `now` (N, 4)."""
    self._rows[:, which] = now[which]

  def before(self, lags: tuple[float, ...]) -> Array:
    """What was so many s ago, rounded to periods, (N, len(lags), 4).

    Raises:
      ValueError: longer ago than is remembered.
    """
    steps = np.array([round(lag / self._period) for lag in lags], dtype=np.int64)
    if steps.size and not 0 <= steps.min() <= steps.max() < len(self._rows):
      raise ValueError(f"{max(lags):g} s ago is not remembered; at most {MEMORY:g} s are")
    return self._rows[(self._newest - steps) % len(self._rows)].transpose(1, 0, 2)

  def of(self, which: slice) -> "Recent":
    """The same of some of the cars, to look at."""
    some = object.__new__(Recent)
    some._period, some._newest, some._rows = self._period, self._newest, self._rows[:, which]
    return some
