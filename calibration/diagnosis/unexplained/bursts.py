"""Bursts in a residual: a few short moments that hold most of what a model misses.

A wrong formula errs wherever its circumstances return. What happens now and then of itself (a lost command, a stuck
message, a wheel off the floor) leaves most of the drive untouched, and no function of circumstances finds it.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.circumstances import at_values
from calibration.fitting.observations import Observations
from qcar_twin.plant import Prediction

Array = NDArray[np.float64]

_WINDOW = 0.25  # s
_FEW = 0.05  # share of the windows that are looked at
_LEAST = 100  # windows
_MOVING = 0.1  # m/s; a car that mostly stands errs only when it moves, and that is no burst


@dataclasses.dataclass(frozen=True)
class Burst:
  """The strongest moments of one channel's residual.

  Attributes:
    share: of the sum of squares that the strongest twentieth of all quarter seconds holds, 0 to 1.
    windows: quarter seconds there are; 0 if there are too few to tell.
    sum_of_squares: that the strongest twentieth holds.
  """

  share: float
  windows: int
  sum_of_squares: float

  @property
  def odds(self) -> float:
    """share / (1 - share)."""
    return self.share / max(1.0 - self.share, 1e-6)

  @property
  def depends_on(self) -> tuple[str, ...]:
    return (f"time: {self.share:.0%} of it in a twentieth of all quarter seconds",)


def bursts(residual: Array, observations: Observations, prediction: Prediction, channel: str) -> Burst:
  """How much of one channel's residual lies in its strongest moments, of those in which the car moves.

  Args:
    residual: of all values, (M,).
    observations, prediction: what was measured, and the model's signals of one vector.
    channel: to look at.
  """
  speed = at_values(prediction.channel("velocity_x")[0][..., None], observations, channel)[:, 0]
  rows = np.flatnonzero(observations.select(channel))[np.abs(speed) > _MOVING]
  window = observations.recording[rows] * 100_000 + (observations.time[rows] // _WINDOW).astype(np.int64)
  index = np.unique(window, return_inverse=True)[1].reshape(-1)
  power = np.sort(np.bincount(index, residual[rows] ** 2))[::-1]
  if len(power) < _LEAST or power.sum() <= 0.0:
    return Burst(0.0, 0, 0.0)
  strongest = float(power[: int(_FEW * len(power))].sum())
  return Burst(strongest / float(power.sum()), len(power), strongest)
