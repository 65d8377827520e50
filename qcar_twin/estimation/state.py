"""What the filter of N cars knows at one instant, and what came in during one period."""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.estimation.models import BETA, V
from qcar_twin.estimation.watches.gyro import GyroWatch
from qcar_twin.estimation.watches.model import ModelWatch
from qcar_twin.estimation.watches.monitor import SpeedWatch, StampWatch

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
START_STD = (0.1, 0.1, 0.5, 0.1, 0.1, 0.5)  # m, m, m/s, rad, rad, rad/s: of EKF_BM after the first fix
POINT_START_STD = (0.1, 0.1, 0.5, 0.5)  # m, m, m/s, m/s
PLACE, VELOCITY = slice(0, 2), slice(2, 4)  # columns of EKF_PM's state; PLACE also of a fix and of EKF_BM's state
REFUSALS = (
  ("speed", "gate"), ("yaw_rate", "gate"), ("pose", "gate"), ("pose", "gate of the point filter"),
  ("pose", "off the beat"),
)  # fmt: skip
"""Why a measurement is not used, by channel and reason: columns of `FilterState.turned_away`."""


@dataclasses.dataclass
class FilterState:
  """N cars; its arrays are replaced, never written into, so that a copy need not copy them.

  Attributes:
    bicycle, bicycle_covariance: EKF_BM, (N, n), (N, n, n), n = 6 and one for each number that is unknown
      (`FilterSettings.rows`).
    point, point_covariance: EKF_PM, (N, 4), (N, 4, 4).
    commands: last voltage, V, and steering command, rad, (N, 2).
    waiting: commands that are still under way, the oldest first, (N, d, 2).
    servo_angle: after the servo's lag, rad, (N,).  wheel_angle: of the road wheels, after the linkage, rad, (N,).
    holds: whether any floor holds the car as it is driven, (N,).
    accel: last, at the IMU, m/s^2, (N, 2).  accel_age: since then, s, (N,).
    age: since the last accepted fix, s, (N,).  silent: since anything has arrived, s, (N,).
    hole: longest silence since the last fix, s, (N,).
    refused: fixes refused in a row, (N,).
    steady: votes of refused fixes for another place, each where a car could have got to from the one before, (N,).
    last: the last of them, m, (N, 2).  driven: distance since that fix, m, (N,).
    fixes, strays: fixes so far, and those that nothing has borne out, fading, (N,).
    watches: of the encoders, one per car; empty where they are not watched.
    clocks: of the stamps of their fixes, one per car; empty where they are not watched.  odometers: of their gyros.
    models: of their single tracks.
    unseen: rad by which a bias of the gyro may turn the yaw before it is detected, (N,).
    evidence: log likelihood of the fixes so far in EKF_BM and in EKF_PM (constants left out), what is beyond a gate
      counting as if on its edge, (N, 2).
    turned_away: measurements that were not used so far, by REFUSALS, (N, 5).
  """

  bicycle: Array
  bicycle_covariance: Array
  point: Array
  point_covariance: Array
  commands: Array
  waiting: Array
  servo_angle: Array
  wheel_angle: Array
  holds: Mask
  accel: Array
  accel_age: Array
  age: Array
  silent: Array
  hole: Array
  refused: NDArray[np.int64]
  steady: NDArray[np.int64]
  last: Array
  driven: Array
  fixes: Array
  strays: Array
  unseen: Array
  evidence: Array
  turned_away: NDArray[np.int64]
  watches: tuple[SpeedWatch, ...] = ()
  clocks: tuple[StampWatch, ...] = ()
  odometers: tuple[GyroWatch, ...] = ()
  models: tuple[ModelWatch, ...] = ()

  @classmethod
  def at(
    cls, pose: Array, speed: Array, std: float, watched: bool = False, unknown: Sequence[float] = (), delay: int = 0
  ) -> "FilterState":
    """Cars at poses, m, m, rad, (N, 3), with standard deviation `std`, and speeds, m/s, (N,).

    Args:
      watched: whether their sensors are watched.
      unknown: standard deviations of the numbers that are estimated besides.
      delay: of the commands, periods.
    """
    count = len(pose)
    x, y, yaw = pose.T
    none = np.zeros(count)
    spread = np.array([std, std, START_STD[V], std, *START_STD[BETA:], *unknown])
    point_spread = np.array([std, std, *POINT_START_STD[VELOCITY]])
    return cls(
      bicycle=np.stack([x, y, speed, yaw, none, none, *[none] * len(unknown)], axis=-1),
      bicycle_covariance=np.tile(np.diag(spread**2), (count, 1, 1)),
      point=np.stack([x, y, speed * np.cos(yaw), speed * np.sin(yaw)], axis=-1),
      point_covariance=np.tile(np.diag(point_spread**2), (count, 1, 1)),
      commands=np.zeros((count, 2)),
      waiting=np.zeros((count, delay, 2)),
      servo_angle=none,
      wheel_angle=none,
      holds=np.ones(count, dtype=bool),
      accel=np.zeros((count, 2)),
      accel_age=np.full(count, np.inf),
      age=none,
      silent=none,
      hole=none,
      refused=np.zeros(count, dtype=np.int64),
      steady=np.zeros(count, dtype=np.int64),
      last=np.zeros((count, 2)),
      driven=none,
      fixes=none,
      strays=none,
      unseen=none,
      evidence=np.zeros((count, 2)),
      turned_away=np.zeros((count, len(REFUSALS)), dtype=np.int64),
      watches=tuple(SpeedWatch() for _ in range(count * watched)),
      clocks=tuple(StampWatch() for _ in range(count * watched)),
      odometers=tuple(GyroWatch() for _ in range(count * watched)),
      models=tuple(ModelWatch() for _ in range(count * watched)),
    )

  def copy(self) -> "FilterState":
    """One that can go its own way."""
    return copy.copy(self)

  def refuse(self, channel: str, reason: str, which: Mask) -> None:
    """Count a measurement of some cars, (N,), that is not used, for a reason of REFUSALS."""
    if which.any():
      column = np.arange(len(REFUSALS)) == REFUSALS.index((channel, reason))
      self.turned_away = self.turned_away + which[:, None] * column

  @property
  def sound(self) -> Mask:
    """Whether the numbers are those of a filter, (N,): numbers, and positive variances of place, motion and what both
    filters' places have in common. Commands or sensors in units that are wrong by thousands make others."""
    mine, theirs = self.bicycle_covariance[:, PLACE, PLACE], self.point_covariance[:, PLACE, PLACE]
    variances = [np.diagonal(c, axis1=1, axis2=2) for c in (self.bicycle_covariance, self.point_covariance)]
    least = np.concatenate([*variances, *(np.linalg.det(c)[:, None] for c in (mine, theirs, mine + theirs))], axis=1)
    return np.asarray((least > 0.0).all(axis=1) & np.isfinite(self.bicycle).all(axis=1))

  @property
  def against(self) -> NDArray[np.int64]:
    """Fixes that speak for another place, (N,)."""
    return np.maximum(self.refused, self.steady)

  @property
  def hidden(self) -> Array:
    """Rad by which the yaw may be wrong besides its covariance: a bias unseen yet, a gyro against its model, (N,)."""
    return self.unseen + [watch.risked for watch in self.models] if self.models else self.unseen

  def put(self, which: Mask, other: "FilterState") -> None:
    """Take over some cars of another state of as many."""
    for name, mine in vars(self).items():
      theirs = getattr(other, name)
      if isinstance(mine, tuple):
        setattr(self, name, tuple(b if new else a for new, a, b in zip(which, mine, theirs, strict=False)))
      else:
        setattr(self, name, choose(which, theirs, mine))


def choose(which: Mask, these: Array, others: Array) -> Array:
  """Rows of `these` for the cars in `which`, else of `others`; (N, ...)."""
  return np.where(which.reshape(-1, *(1,) * (others.ndim - 1)), these, others)


@dataclasses.dataclass(slots=True)
class Slot:
  """One period of N cars: what came in, NaN for no news, and the filter after it.

  Attributes:
    commands: voltage, V, and steering command, rad, from this slot on, (N, 2).
    accel: at the IMU, m/s^2, acts from this slot on, (N, 2).
    motion: measured speed, m/s, and yaw rate, rad/s, (N, 2).
    fix: lidar x, y, m, yaw, rad, score, (N, 4); None for none.
    offset: stamp of the fix after the slot's own time, s.
    outcome: None while the filter has not passed.
  """

  commands: Array
  accel: Array
  motion: Array
  fix: Array | None = None
  offset: float = 0.0
  outcome: FilterState | None = None

  @property
  def heard(self) -> Mask:
    """Cars of which anything has come in, (N,)."""
    parts = (self.commands, self.accel, self.motion) + (() if self.fix is None else (self.fix,))
    return np.asarray(np.isfinite(np.concatenate(parts, axis=1)).any(axis=1))

  @classmethod
  def empty(cls, count: int) -> "Slot":
    """Nothing has come in for N cars."""
    commands, accel, motion = np.full((3, count, 2), np.nan)
    return cls(commands, accel, motion)
