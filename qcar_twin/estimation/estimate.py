"""What a filter reports about one car at one time."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_twin.estimation.models import BETA, YAW, R, V

Snapshot = tuple[NDArray[np.float64], NDArray[np.float64]]  # state and covariance
MOTION = (("pose_yaw", YAW), ("speed", V), ("sideslip_angle", BETA), ("yaw_rate", R))  # names in EKF_BM's state


class Estimate(NamedTuple):
  """What is known at one time, SI units.

  Attributes:
    time: s.
    pose_x, pose_y: the master's, m; NaN until the first pose.
    pose_yaw, speed, sideslip_angle, yaw_rate: EKF_BM's, rad (unwrapped), m/s, rad, rad/s.
    covariance: of the master's position, m^2: xx, xy, yy.
    bicycle, point: state and covariance of EKF_BM and EKF_PM; None for a filter that is off.
    reasons: why the estimate should not be used; empty when it is valid.
    warnings: what is wrong with the sensors although the estimate may be used.
  """

  time: float
  pose_x: float
  pose_y: float
  pose_yaw: float
  speed: float
  sideslip_angle: float
  yaw_rate: float
  covariance: tuple[float, float, float]
  bicycle: Snapshot | None
  point: Snapshot | None
  reasons: tuple[str, ...]
  warnings: tuple[str, ...] = ()

  @property
  def valid(self) -> bool:
    """Whether the estimate may be used."""
    return not self.reasons

  @property
  def velocity_x(self) -> float:
    """Body frame, forward, m/s."""
    return self.speed * math.cos(self.sideslip_angle)

  @property
  def velocity_y(self) -> float:
    """Body frame, left, m/s."""
    return self.speed * math.sin(self.sideslip_angle)

  @property
  def std(self) -> dict[str, float]:
    """Standard deviations of the six estimates by name."""
    variance = np.full(6, np.inf) if self.bicycle is None else np.diag(self.bicycle[1])
    out = {"pose_x": math.sqrt(self.covariance[0]), "pose_y": math.sqrt(self.covariance[2])}
    return out | {name: math.sqrt(variance[row]) for name, row in MOTION}


def no_estimate(time: float, reason: str) -> Estimate:
  """An estimate that says nothing but why."""
  nan, inf = math.nan, math.inf
  return Estimate(time, nan, nan, nan, nan, nan, nan, (inf, 0.0, inf), None, None, (reason,))
