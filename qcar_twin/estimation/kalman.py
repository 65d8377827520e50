"""The wall around filterpy: the only file that imports it.

`LocalFilter` is filterpy's extended Kalman filter with the prediction given from outside, selected
rows of the state as measurement, and a gate on the normalised innovation squared (NIS) before use.
"""

from collections.abc import Callable, Iterable

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

Array = NDArray[np.float64]
Snapshot = tuple[Array, Array]  # state and covariance; filterpy replaces both arrays, it never writes into them


class LocalFilter(ExtendedKalmanFilter):
  """An extended Kalman filter whose measurements are components of its state.

  Args:
    state: initial estimate, (n,).
    covariance: of its error, (n, n).
    model_noise: covariance added per prediction, (n, n).
  """

  def __init__(self, state: Array, covariance: Array, model_noise: Array):
    super().__init__(dim_x=len(state), dim_z=1)
    self.x = np.array(state, dtype=np.float64)
    self.P = np.array(covariance, dtype=np.float64)
    self.Q = np.array(model_noise, dtype=np.float64)
    self._following = self.x
    self._selectors: dict[tuple[int, ...], Callable[[Array], Array]] = {}

  @property
  def snapshot(self) -> Snapshot:
    """State and covariance as they are now."""
    return self.x, self.P

  def restore(self, snapshot: Snapshot) -> None:
    """Go back to an earlier snapshot."""
    self.x, self.P = snapshot

  def predict_x(self, u: object = 0) -> None:
    """Called by filterpy's `predict`: take the state computed outside by the nonlinear model."""
    self.x = self._following

  def predict_to(self, following: Array, transition: Array) -> None:
    """Predict to a state computed outside; P <- F P F' + Q with F = d following / d x, (n, n)."""
    self._following, self.F = following, transition
    self.predict()

  def innovation_covariance(self, rows: tuple[int, ...], noise: Array) -> Array:
    """S = H P H' + R for H selecting `rows`; noise is R, (k, k)."""
    return self.P[np.ix_(rows, rows)] + noise

  def correct(self, rows: tuple[int, ...], innovation: Iterable[float], noise: Array) -> None:
    """Update with z - h(x) already formed (angles wrapped), for H selecting `rows`.

    Args:
      rows: which state each measurement is of, k of them.
      innovation: (k,).
      noise: R, (k, k).
    """
    select = self._selectors.get(rows)
    if select is None:
      selector = np.eye(self.dim_x)[list(rows)]
      select = self._selectors[rows] = lambda _: selector
    # a tuple: filterpy deep-copies what it is given, which is slow for arrays
    self.update(tuple(innovation), select, _zero, noise)

  def correct_with(self, selector: Array, innovation: Array, noise: Array) -> None:
    """The same for any measurement matrix H = d h / d x, (k, n)."""
    self.update(innovation, lambda _: selector, _zero, noise)


def _zero(_: Array) -> float:
  """The innovation is formed outside, so the predicted measurement is zero."""
  return 0.0
