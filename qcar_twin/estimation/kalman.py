"""The extended Kalman filter of N cars side by side: prediction, and correction by one scalar after the other.

Measurement noise is independent between components, so taking a fix component by component is the joint update
exactly (Simon, Optimal State Estimation, Wiley 2006, section 6.1), its normalised innovations squared and the
logarithms of its innovation variances add up to those of the joint fix, and no matrix is inverted.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Corrected(NamedTuple):
  """What a measurement of several components makes of N estimates.

  Attributes:
    state, covariance: afterwards, (N, n) and (N, n, n).
    nis: normalised innovation squared of the components used, (N,).
    log_determinant: of their innovation covariance, (N,).
  """

  state: Array
  covariance: Array
  nis: Array
  log_determinant: Array


def predict(covariance: Array, transition: Array, noise: Array) -> Array:
  """F P F' + Q, (N, n, n), for P (N, n, n), F (N, n, n) or (n, n), Q (n, n)."""
  return transition @ covariance @ transition.swapaxes(-1, -2) + noise


def absorb(
  state: Array, covariance: Array, column: Array, spread: Array, innovation: Array, used: Mask
) -> tuple[Array, Array]:
  """State and covariance after one scalar measurement with slope h: x + K y, P - K (P h)', K = P h / s.

  Args:
    column: P h, (N, n).  spread: s = h' P h + R, (N,).
    innovation: y, finite, (N,).  used: cars that have the measurement, (N,); the others stay as they are.
  """
  gain = np.where(used[:, None], column / spread[:, None], 0.0)
  return state + gain * innovation[:, None], covariance - gain[:, :, None] * column[:, None, :]


def correct(
  state: Array, covariance: Array, row: int, value: Array, noise: Array | float, used: Mask
) -> tuple[Array, Array, Array, Array]:
  """Take measured values, (N,), of one component of the state, of variance `noise`.

  Returns:
    State and covariance afterwards, innovation (zero where not used) and its variance, (N,) each.
  """
  column = covariance[:, :, row]
  spread = column[:, row] + noise
  innovation = np.where(used, value - state[:, row], 0.0)
  return *absorb(state, covariance, column, spread, innovation, used), innovation, spread


def correct_together(
  state: Array, covariance: Array, rows: Sequence[int], values: Array, noise: Array, used: Mask
) -> Corrected:
  """Take a fix of several components of the state at once.

  Args:
    rows: which components, k of them.
    values, noise: measured, with angles within half a turn of the state, and their variances, (N, k).
    used: components that were measured, (N, k).
  """
  nis, log_determinant = np.zeros(len(state)), np.zeros(len(state))
  for i, row in enumerate(rows):
    state, covariance, innovation, spread = correct(state, covariance, row, values[:, i], noise[:, i], used[:, i])
    nis += innovation**2 / spread
    log_determinant += np.where(used[:, i], np.log(spread), 0.0)
  return Corrected(state, covariance, nis, log_determinant)
