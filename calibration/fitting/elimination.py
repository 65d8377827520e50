"""Start states as parameters of each stretch, eliminated from every least squares.

A stretch of driving begins in a state x that nobody knows exactly: it was measured with a covariance P. To first order
a stretch's whitened residual is r + U z with the state's error in standard deviations z ~ N(0, I) and the slopes
U = J P^1/2. The least squares over z,

  min_z |r + U z|^2 + |z|^2 = r' (I + U U')^-1 r = |A r|^2,   A = I - Q diag(1 - 1 / sqrt(1 + s^2)) Q',

with the singular vectors Q and values s of U (the Schur complement of the normal equations in z: Golub and Pereyra, The
differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate, SIAM Journal on
Numerical Analysis 10, 1973). A is applied to residuals and slopes alike: what follows is a least squares like any
other, and its sum of squares still counts nats.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.observations import Observations
from qcar_twin.plant import START
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

ELIMINATED = ("velocity_x", "velocity_y", "yaw_rate", "steering_angle")
_COLUMNS = [START.index(name) for name in ELIMINATED]


@dataclasses.dataclass(frozen=True)
class Elimination:
  """A of every stretch, for values in the order of observations.

  Attributes:
    slopes: d value / d start state in the state's standard deviations, in the channels' units, (M, k).
    basis: Q in the rows of each stretch, (M, k).
    shrink: 1 - 1 / sqrt(1 + s^2) of each stretch, (S, k).
    edges: row at which each stretch's values begin, and the end, (S + 1,).
  """

  slopes: Array
  basis: Array
  shrink: Array
  edges: NDArray[np.int64]

  @classmethod
  def of(cls, slopes: Array, scale: Array, stretch: NDArray[np.int64]) -> "Elimination":
    """From slopes (M, k), what whitens each value (M,) and the stretch of each value (M,), in rising order."""
    edges = np.append(np.flatnonzero(np.diff(stretch, prepend=-1)), len(stretch))
    basis, shrink = np.zeros_like(slopes), np.zeros((len(edges) - 1, slopes.shape[1]))
    for k, (low, high) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
      q, s, _ = np.linalg.svd(slopes[low:high] * scale[low:high, None], full_matrices=False)
      basis[low:high, : len(s)], shrink[k, : len(s)] = q, 1.0 - 1.0 / np.sqrt(1.0 + s**2)
    return cls(slopes, basis, shrink, edges)

  def apply(self, residual: Array, first: int = 0) -> None:
    """A r in place: residuals (n, m), whose values begin in row `first`, at the beginning of a stretch."""
    begin, end = np.searchsorted(self.edges, [first, first + residual.shape[1]])
    for k in range(begin, end):
      rows = slice(self.edges[k], self.edges[k + 1])
      basis, part = self.basis[rows], residual[:, self.edges[k] - first : self.edges[k + 1] - first]
      part -= ((part @ basis) * self.shrink[k]) @ basis.T


def start_slopes(twin: Twin, observations: Observations, theta: Array) -> Array:
  """Slopes of every value by its stretch's start state, in standard deviations of the state, at theta (P,), (M, k).

  Central differences over half a deviation either way: all stretches move together, since none shares a state.
  """
  stretches = observations.stretches
  slopes = np.zeros((len(observations), len(_COLUMNS)))
  for k, column in enumerate(_COLUMNS):
    moved = []
    for sign in (0.5, -0.5):
      start = stretches.segments.start.copy()
      start[:, column] += sign * stretches.start_std[:, column]
      segments = dataclasses.replace(stretches.segments, start=start)
      moved.append(observations.predict(twin.rollout(theta[None], segments))[0])
    slopes[:, k] = moved[0] - moved[1]
  return np.nan_to_num(slopes, posinf=0.0, neginf=0.0)
