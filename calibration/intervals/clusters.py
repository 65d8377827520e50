"""Standard deviations of fitted parameters when neighbouring samples share their disturbances.

Road noise, slip and what the model has not lie over many samples alike, so that these are no independent witnesses. The
unit is a recording, or a stretch of about ten seconds where a data set has few recordings.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from calibration.fitting.observations import Observations
from calibration.fitting.optimiser import Fit, inverse_curvature
from qcar_twin.parameters import ParameterSet

Array = NDArray[np.float64]
_SIDE = 0.95  # of a two-sided 90 % interval


def groups_of(observations: Observations, least: int = 8, length: float = 10.0) -> NDArray[np.int64]:
  """Group number of every value, (M,): recordings, or stretches of `length` s where those are few."""
  if len(observations.names) >= least:
    return observations.recording
  stretch = observations.recording * 100_000 + (observations.time // length).astype(np.int64)
  return np.unique(stretch, return_inverse=True)[1].reshape(-1)


@dataclasses.dataclass(frozen=True)
class Scatter:
  """Scatter of fitted parameters, the sandwich C (sum_g s_g s_g' + P) C.

  s_g = J_g' r_g are the slopes of each group about their mean, P is the prior's precision and C the inverse posterior
  curvature (Liang and Zeger, Biometrika 73, 1986, eq. 4).

  Attributes:
    sandwich: (p, p).
    inverse: C, (p, p): the covariance where neighbouring samples are independent.
  """

  sandwich: Array
  inverse: Array

  def std(self, directions: Array | None = None) -> Array:
    """Standard deviations of the parameters, (p,), or of sums of them, (k,); never below those of `inverse`.

    Args:
      directions: weights of the sums, (k, p).
    """
    asked = np.eye(len(self.inverse)) if directions is None else directions
    along = lambda matrix: np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", asked, matrix, asked), 0.0))
    return np.maximum(along(self.sandwich), along(self.inverse))

  def covariance(self) -> Array:
    """Covariance with the deviations of `std` and the sandwich's correlations, (p, p)."""
    own = np.sqrt(np.maximum(np.diag(self.sandwich), 0.0))
    stretch = self.std() / np.where(own > 0.0, own, 1.0)
    return self.sandwich * np.outer(stretch, stretch)


def scatter_of(
  jacobian: Array, residual: Array, group: NDArray[np.int64], free: ParameterSet, values: Array
) -> Scatter:
  """Scatter of a maximum a posteriori fit.

  Args:
    jacobian: d whitened residual / d parameters, (M, p).
    residual: whitened, (M,).
    group: of every value, (M,).
    free: the fitted parameters with their priors.
    values: estimates, (p,).
  """
  pulls, prior = jacobian * residual[:, None], np.diag(free.deviation_slopes(values) ** 2)
  slopes = np.stack([np.bincount(group, column) for column in pulls.T], axis=1)[np.unique(group)]
  slopes -= slopes.mean(axis=0)
  count = len(slopes)
  inverse = inverse_curvature(jacobian.T @ jacobian + prior, free)
  between = slopes.T @ slopes * (count / max(count - 1, 1))
  return Scatter(inverse @ (between + prior) @ inverse, inverse)


def fitted_std(fitted: Fit, group: NDArray[np.int64]) -> Array:
  """Standard deviations of a fit's estimates whose 1.645 fold holds 90 %, (p,); prior ones at a bound.

  Few groups tell their scatter badly: Student's t with one degree of freedom less than groups, over the normal.

  Args:
    fitted: with its slopes.
    group: of every residual value, (M,).
  """
  free, std = np.flatnonzero(~fitted.at_bound), fitted.std.copy()
  if not len(free):
    return std
  loose = ParameterSet(p for p, bound in zip(fitted.parameters, fitted.at_bound, strict=True) if not bound)
  scatter = scatter_of(fitted.jacobian[:, free], fitted.residual, group, loose, fitted.theta[free])
  few = float(stats.t.ppf(_SIDE, max(len(np.unique(group)) - 1, 1)) / stats.norm.ppf(_SIDE))
  std[free] = few * scatter.std()
  return std
