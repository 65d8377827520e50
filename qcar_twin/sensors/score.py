"""How a lidar's own score tells the variance of its pose."""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ScoreVariance:
  """Variance of a lidar coordinate from the lidar's own score, the paper's eq. (R_lidar).

  R(l_s) = k1 tanh(k2 / l_s - k3) + k4: k4 - k1 tanh(k3) for a perfect score, k4 + k1 for none.
  k1 and k4 carry the coordinate's unit squared, k2 the score's unit, k3 is a number.
  """

  k1: float
  k2: float
  k3: float
  k4: float

  def __post_init__(self) -> None:
    if min(dataclasses.astuple(self)) <= 0.0 or self.k4 <= self.k1 * math.tanh(self.k3):
      raise ValueError("a score variance needs four positive constants with k4 > k1 tanh(k3)")

  def __call__(self, score: float) -> float:
    """Variance at one score; a score of zero or less counts as none."""
    if score <= 0.0:
      return self.k4 + self.k1
    return self.k1 * math.tanh(self.k2 / score - self.k3) + self.k4

  def of(self, scores: ArrayLike) -> Array:
    """Variances at scores of any shape."""
    scores = np.asarray(scores, dtype=np.float64)
    safe = np.where(scores > 0.0, scores, 1.0)
    return np.where(scores > 0.0, self.k1 * np.tanh(self.k2 / safe - self.k3) + self.k4, self.k4 + self.k1)

  @classmethod
  def between(cls, best: float, worst: float, middle: float, sharpness: float = 1.0) -> "ScoreVariance":
    """From standard deviations at an endless and at no score, and the score at which tanh passes zero."""
    k1 = (worst**2 - best**2) / (1.0 + math.tanh(sharpness))
    return cls(k1, sharpness * middle, sharpness, worst**2 - k1)

  @classmethod
  def fit(cls, scores: ArrayLike, errors: ArrayLike) -> "ScoreVariance":
    """Maximum likelihood of zero-mean Gaussian errors (k,) with variance R(score), for scores (k,).

    Raises:
      ValueError: fewer than 50 pairs.
    """
    scores, errors = np.asarray(scores, dtype=np.float64), np.asarray(errors, dtype=np.float64)
    keep = np.isfinite(scores) & np.isfinite(errors)
    scores, errors = scores[keep], errors[keep]
    if len(scores) < 50:
      raise ValueError(f"{len(scores)} pairs of score and error are too few to fit a variance; record at least 50")
    spread = max(float(np.std(errors)), 1e-9)

    start = np.log([0.5 * spread, spread, max(float(np.median(scores)), 1e-3), 1.0])

    def curve(z: Array) -> "ScoreVariance":
      best, extra, middle, sharpness = np.exp(np.clip(z, start - 5.0, start + 5.0))
      return cls.between(best, math.hypot(best, extra), middle, min(sharpness, 5.0))

    def cost(z: Array) -> float:
      variance = curve(z).of(scores)
      return 0.5 * float(np.mean(np.log(variance) + errors**2 / variance))

    return curve(minimize(cost, start, method="Nelder-Mead", options={"maxiter": 2000, "fatol": 1e-9}).x)

  def times(self, factor: float) -> "ScoreVariance":
    """The same curve with `factor` times the variance."""
    return dataclasses.replace(self, k1=self.k1 * factor, k4=self.k4 * factor)
