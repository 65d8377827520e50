"""What a filter reports about one car, or about N cars, at one time, and what speaks against it."""

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_twin.estimation.models import BETA, YAW, R, V
from qcar_twin.estimation.settings import FilterSettings

Array = NDArray[np.float64]
Snapshot = tuple[Array, Array]  # state and covariance
BROKEN = "its numbers are beyond a filter's arithmetic: check the units of commands and sensors"
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
    bounds: of the errors of position, m, and yaw, rad, each exceeded with the probability `FilterSettings.risk`.
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
  bounds: tuple[float, float] = (math.inf, math.inf)

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


@dataclasses.dataclass(frozen=True)
class BatchEstimate:
  """Fused estimates of N cars, units as in `Estimate`."""

  pose: Array  # x, y, yaw, (N, 3)
  velocity: Array  # body frame at the centre of gravity, m/s, (N, 2)
  speed: Array  # (N,)
  sideslip_angle: Array  # (N,)
  yaw_rate: Array  # (N,)
  covariance: Array  # of the position: xx, xy, yy, (N, 3)
  valid: NDArray[np.bool_]  # (N,)
  bounds: Array  # of the errors of position, m, and yaw, rad, (N, 2)


def bounds_of(settings: FilterSettings, covariance: Any, yaw_variance: Any, unseen: Any) -> tuple[Any, Any]:
  """What the errors of position, m, and yaw, rad, exceed with the probability `risk` only.

  Args:
    covariance: xx, xy, yy, m^2; EKF_BM's own where both filters use the lidar in full and the fusion believes too much.
    yaw_variance: rad^2.
    unseen: rad by which a fault may turn the yaw before it is detected.  Numbers of one car or arrays (N,).
  """
  xx, xy, yy = covariance
  largest = 0.5 * (xx + yy) + (0.25 * (xx - yy) ** 2 + xy**2) ** 0.5
  place, angle = settings.reach
  return place * largest**0.5, angle * yaw_variance**0.5 + unseen


def doubts(
  settings: FilterSettings, position_variance: Any, yaw_variance: Any, age: Any, against: Any, silent: Any
) -> tuple[tuple[Any, str, Any], ...]:
  """What may speak against an estimate: whether it does, in which words, and the number in them.

  Args:
    position_variance: the larger one, m^2.  yaw_variance: rad^2.  age: of the last accepted pose, s.
    against: poses that contradict it.  silent: since anything has arrived, s.  Numbers of one car or arrays (N,).
  """
  return (
    (position_variance > settings.position_limit**2, "position known to {:.2f} m only", position_variance**0.5),
    (yaw_variance > settings.yaw_limit**2, "yaw known to {:.2f} rad only", yaw_variance**0.5),
    (age > settings.lidar_timeout, "no accepted pose for {:.1f} s", age),
    (silent > settings.buffer + settings.accel_timeout, "nothing has arrived for {:.1f} s", silent),
    (against >= min(3, settings.lost_after), "{} poses contradict the estimate", against),
  )
