"""The federated filter for many cars side by side, for training: the same equations without filterpy.

Equal to `FederatedFilter` to rounding, gates, late fixes and lost cars included. It differs in what
it takes: all cars share one clock with one sample per period, a fix is complete or absent and of one age for all
cars, and the encoder is not watched (`SpeedWatch`). NaN means "no sample" for that car.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from qcar_twin.estimation.local_filters import LOST_STD, POINT_START_STD, START_STD
from qcar_twin.estimation.master import fuse_positions
from qcar_twin.estimation.models import BETA, YAW, R, V, X, Y, bicycle_step, cg_acceleration, fill_jacobian, point_step
from qcar_twin.estimation.monitor import MOTION, STEADY
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.kinematics import wrap_angle
from qcar_twin.single_track import Car

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
ROWS = (X, Y, YAW)


@dataclasses.dataclass
class Cars:
  """State of all filters: what `FederatedFilter` keeps per car, with the car as first axis."""

  bicycle: Array  # (N, 6)
  bicycle_covariance: Array  # (N, 6, 6)
  point: Array  # (N, 4)
  point_covariance: Array  # (N, 4, 4)
  steering: Array  # road-wheel angle after the servo's lag, rad, (N,)
  accel: Array  # at the IMU, m/s^2, (N, 2)
  accel_age: Array  # s, (N,)
  age: Array  # since the last accepted fix, s, (N,)
  refused: NDArray[np.int64]  # fixes in a row, (N,)
  steady: NDArray[np.int64]  # of those, in a row, in agreement, (N,)
  last: Array  # last refused fix, m, (N, 2)
  driven: Array  # distance since that fix, m, (N,)

  @classmethod
  def at_rest(cls, count: int) -> "Cars":
    """N cars that nothing is known of."""

    def zeros(*shape: int) -> Array:
      return np.zeros((count, *shape))

    none = np.zeros(count, dtype=np.int64)
    old = np.full(count, np.inf)
    return cls(
      zeros(6),
      zeros(6, 6),
      zeros(4),
      zeros(4, 4),
      zeros(),
      zeros(2),
      old,
      zeros(),
      none,
      none.copy(),
      zeros(2),
      zeros(),
    )

  def copy(self) -> "Cars":
    """An independent copy."""
    return Cars(*(getattr(self, field.name).copy() for field in dataclasses.fields(self)))

  def put(self, which: Mask, other: "Cars") -> None:
    """Overwrite some cars."""
    for field in dataclasses.fields(self):
      getattr(self, field.name)[which] = getattr(other, field.name)[which]


@dataclasses.dataclass(frozen=True)
class BatchEstimate:
  """Fused estimates of N cars, units as in `Estimate`."""

  pose: Array  # x, y, yaw, (N, 3)
  velocity: Array  # body frame at the centre of gravity, m/s, (N, 2)
  speed: Array  # (N,)
  sideslip_angle: Array  # (N,)
  yaw_rate: Array  # (N,)
  covariance: Array  # of the position: xx, xy, yy, (N, 3)
  valid: Mask  # (N,)


@dataclasses.dataclass
class Samples:
  """One period: its measurements, the inputs from it on, the state after it."""

  motion: Array  # speed m/s and yaw rate rad/s, (N, 2)
  commands: Array  # V, rad, (N, 2)
  accel: Array  # (N, 2)
  fix: Array | None = None  # x, y, yaw, score, (N, 4)
  outcome: Cars = dataclasses.field(default_factory=lambda: Cars.at_rest(0))


class FederatedBatch:
  """EKF_BM, EKF_PM and their master for N cars.

  Each period: `advance` with what has been measured, `estimate`, `command`.

  Args:
    car: the identified model, one for all cars.
    settings: as for one car.
    count: N.
    oldest: age of the oldest fix that may arrive, periods.
  """

  def __init__(self, car: Car, settings: FilterSettings, count: int, oldest: int = 10):
    self.settings, self.car, self.count = settings, car, count
    self.cars = Cars.at_rest(count)
    self.nis = np.full((count, 2), np.nan)
    self._oldest = oldest
    self._step_index = 0
    self._begun = np.zeros(count, dtype=np.int64)
    self._beginning = self.cars.copy()
    none = np.full((count, 2), np.nan)
    self._past = [Samples(none, np.zeros((count, 2)), none, outcome=self.cars.copy())]
    self._servo = 1.0 - math.exp(-settings.period / settings.steering_lag) if settings.steering_lag > 0.0 else 1.0
    self._identity = np.broadcast_to(np.eye(6), (count, 6, 6))
    self._point_transition = np.eye(4)
    self._point_transition[0, 2] = self._point_transition[1, 3] = settings.period
    self._unbias = np.array([settings.accel_x_bias, settings.accel_y_bias])

  def start(self, pose: Array, speed: Array, std: float = 0.01, which: Mask | None = None) -> None:
    """Start cars (all, or those of a mask) at known poses (N, 3) and speeds (N,) in the present period."""
    which = np.ones(self.count, dtype=bool) if which is None else which
    fresh = Cars.at_rest(self.count)
    zero = np.zeros(self.count)
    fresh.bicycle = np.stack([pose[:, 0], pose[:, 1], speed, pose[:, 2], zero, zero], axis=-1)
    spread = np.array([std, std, START_STD[V], std, *START_STD[BETA:]])
    fresh.bicycle_covariance[:] = np.diag(spread**2)
    velocity = speed * np.cos(pose[:, 2]), speed * np.sin(pose[:, 2])
    fresh.point = np.stack([pose[:, 0], pose[:, 1], *velocity], axis=-1)
    fresh.point_covariance[:] = np.diag(np.square([std, std, *POINT_START_STD[2:]]))
    self.cars.put(which, fresh)
    self._beginning.put(which, fresh)
    self._begun[which] = self._step_index
    self._past[-1].outcome = self.cars.copy()
    self._past[-1].commands = np.where(which[:, None], 0.0, self._past[-1].commands)
    self._past[-1].accel = np.where(which[:, None], np.nan, self._past[-1].accel)

  def command(self, commands: Array, which: Mask | None = None) -> None:
    """Voltage [V] and steering command [rad] applied from the present period on, (N, 2)."""
    past = self._past[-1]
    past.commands = np.array(commands) if which is None else np.where(which[:, None], commands, past.commands)

  def advance(self, motion: Array, accel: Array, fix: Array | None = None, age: int = 0) -> None:
    """Go on by one period.

    Args:
      motion: speed [m/s] and yaw rate [rad/s] measured at its end, (N, 2).
      accel: at the IMU, m/s^2, (N, 2), acting from its end on.
      fix: lidar x, y [m], yaw [rad], score, measured `age` periods before its end, (N, 4).
    """
    if not 0 <= age <= self._oldest:
      raise ValueError(f"a fix of age {age} periods; at most {self._oldest} are kept, raise `oldest`")
    motion = motion - np.array([0.0, self.settings.yaw_rate_bias])
    self._past.append(Samples(motion, self._past[-1].commands, accel - self._unbias))
    del self._past[: -self._oldest - 2]
    self._step_index += 1
    place = len(self._past) - 1 - age
    first = len(self._past) - 1
    if fix is not None and place >= 1:
      self._past[place].fix = fix
      first = place
    self.cars = self._past[first - 1].outcome.copy()
    for i in range(first, len(self._past)):
      self._step(self._past[i - 1], self._past[i], self._step_index - (len(self._past) - 1 - i))

  # -- one period --------------------------------------------------------------------------------

  def _step(self, before: Samples, now: Samples, index: int) -> None:
    self._predict(before)
    self._correct_motion(now.motion)
    if now.fix is not None:
      self._correct_pose(now.fix, self._begun < index)
    waiting = self._begun >= index  # cars that start later than this replayed period
    if waiting.any():
      self.cars.put(waiting, self._beginning)
    now.outcome = self.cars.copy()

  def _predict(self, before: Samples) -> None:
    cars, settings, h = self.cars, self.settings, self.settings.period
    cars.steering += self._servo * (before.commands[:, 1] - cars.steering)
    heard = np.isfinite(before.accel).all(axis=1)
    cars.accel[heard] = before.accel[heard]
    cars.accel_age[heard] = 0.0
    cars.accel_age += h
    cars.age += h
    cars.driven += np.abs(cars.bicycle[:, V]) * h
    states = tuple(cars.bicycle.T)
    yaw, r = cars.bicycle[:, YAW], cars.bicycle[:, R]
    accel = cg_acceleration(tuple(cars.accel.T), r, (settings.imu_x, settings.imu_y))
    point = point_step(tuple(cars.point.T), accel, yaw + 0.5 * h * r, h, np)
    following, entries = bicycle_step(states, before.commands[:, 0], cars.steering, self.car, h, np)
    transition = self._identity.copy()
    fill_jacobian(transition, entries, h)
    cars.bicycle = np.stack(following, axis=-1)
    moved = transition @ cars.bicycle_covariance @ transition.transpose(0, 2, 1)
    cars.bicycle_covariance = moved + settings.bicycle_noise
    cars.point = np.stack(point, axis=-1)
    f = self._point_transition
    cars.point_covariance = f @ cars.point_covariance @ f.T + settings.point_noise
    if not (off := cars.accel_age > settings.accel_timeout).any():
      return
    self._restart_point(off)

  def _restart_point(self, which: Mask) -> None:
    cars = self.cars
    v, course = cars.bicycle[which, V], cars.bicycle[which, YAW] + cars.bicycle[which, BETA]
    cars.point[which, :2] = cars.bicycle[which, :2]
    cars.point[which, 2:] = np.stack([v * np.cos(course), v * np.sin(course)], axis=-1)
    cars.point_covariance[which] = np.diag(np.square(POINT_START_STD))
    cars.point_covariance[which, :2, :2] = cars.bicycle_covariance[which, :2, :2]

  def _correct_motion(self, motion: Array) -> None:
    """Encoder, then gyro; both gates look at the prediction, as in the joint update."""
    cars, settings = self.cars, self.settings
    noises = (settings.speed_std**2, settings.yaw_rate_std**2)
    faster = 1.0 + settings.front_drive_share * (1.0 / np.cos(cars.steering) - 1.0)
    motion = np.stack([motion[:, 0] / faster, motion[:, 1]], axis=-1)
    used = []
    for i, row in enumerate((V, R)):
      innovation = motion[:, i] - cars.bicycle[:, row]
      variance = cars.bicycle_covariance[:, row, row] + noises[i]
      with np.errstate(invalid="ignore"):
        used.append(innovation**2 <= settings.limits[0] * variance)
    for i, row in enumerate((V, R)):
      column = cars.bicycle_covariance[:, :, row]
      gain = column / (column[:, row] + noises[i])[:, None]
      innovation = np.where(used[i], motion[:, i] - cars.bicycle[:, row], 0.0)
      cars.bicycle += gain * innovation[:, None]
      taken = np.where(used[i][:, None], gain, 0.0)
      cars.bicycle_covariance = cars.bicycle_covariance - taken[:, :, None] * column[:, None, :]

  def _correct_pose(self, fix: Array, alive: Mask) -> None:
    cars, settings = self.cars, self.settings
    present = np.isfinite(fix[:, :3]).all(axis=1) & alive
    position, yaw = settings.pose_noise(
      np.where(np.isfinite(fix[:, 3]), fix[:, 3], settings.score * settings.score_full / 100.0)
    )
    innovation = fix[:, :3] - cars.bicycle[:, ROWS]
    innovation[:, 2] = wrap_angle(np.where(present, innovation[:, 2], 0.0))
    innovation = np.where(present[:, None], innovation, 0.0)
    noise = np.stack([position, position, yaw], axis=-1)
    fits = self._fits(cars.bicycle_covariance, ROWS, innovation, noise / settings.sharing[0], 0)
    lost = self._refuse(present & ~fits, fix[:, :2])
    for row in ROWS:
      cars.bicycle_covariance[lost, row, row] += LOST_STD**2
    accepted = (present & fits) | lost
    share = noise / settings.sharing[0]
    cars.bicycle, cars.bicycle_covariance = _correct(
      cars.bicycle, cars.bicycle_covariance, ROWS, innovation, share, accepted
    )
    cars.age[accepted], cars.refused[accepted], cars.steady[accepted] = 0.0, 0, 0
    self._fix_point(fix[:, :2], noise[:, :2] / settings.sharing[1], accepted)

  def _refuse(self, refused: Mask, place: Array) -> Mask:
    """Count steadily refused fixes; the cars that are lost by now."""
    cars = self.cars
    close = np.hypot(*(place - cars.last).T) < STEADY + MOTION * cars.driven
    steady = np.where((cars.refused > 0) & close, cars.steady + 1, 1)
    cars.steady = np.where(refused, steady, cars.steady)
    cars.refused = np.where(refused, cars.refused + 1, cars.refused)
    cars.last = np.where(refused[:, None], place, cars.last)
    cars.driven = np.where(refused, 0.0, cars.driven)
    return refused & (cars.steady >= self.settings.lost_after)

  def _fix_point(self, fix: Array, noise: Array, accepted: Mask) -> None:
    cars = self.cars
    heard = accepted & (cars.accel_age <= self.settings.accel_timeout)
    innovation = np.where(heard[:, None], fix - cars.point[:, :2], 0.0)
    fits = self._fits(cars.point_covariance, (0, 1), innovation, noise, 1)
    cars.point, cars.point_covariance = _correct(
      cars.point, cars.point_covariance, (0, 1), innovation, noise, heard & fits
    )
    astray = heard & ~fits
    if astray.any():
      self._restart_point(astray)

  def _fits(self, covariance: Array, rows: tuple[int, ...], innovation: Array, noise: Array, which: int) -> Mask:
    total = covariance[np.ix_(range(self.count), rows, rows)] + noise[:, :, None] * np.eye(len(rows))
    nis = np.einsum("ni,ni->n", innovation, np.linalg.solve(total, innovation[..., None])[..., 0])
    self.nis[:, which] = nis
    return nis <= self.settings.limits[len(rows) - 1]

  # -- what is known -----------------------------------------------------------------------------

  def estimate(self) -> BatchEstimate:
    """The master's position and EKF_BM's motion at the present period."""
    cars, settings = self.cars, self.settings
    bm, pm = cars.bicycle_covariance, cars.point_covariance
    own = cars.bicycle[:, X], cars.bicycle[:, Y]
    spread = bm[:, 0, 0], bm[:, 0, 1], bm[:, 1, 1]
    other = pm[:, 0, 0], pm[:, 0, 1], pm[:, 1, 1]
    on = cars.accel_age <= settings.accel_timeout
    fused, fused_spread = fuse_positions(own, spread, (cars.point[:, 0], cars.point[:, 1]), other)
    x, y = (np.where(on, a, b) for a, b in zip(fused, own, strict=True))
    covariance = np.stack([np.where(on, a, b) for a, b in zip(fused_spread, spread, strict=True)], axis=-1)
    v, beta, yaw = cars.bicycle[:, V], cars.bicycle[:, BETA], cars.bicycle[:, YAW]
    valid = np.maximum(covariance[:, 0], covariance[:, 2]) <= settings.position_limit**2
    valid &= bm[:, YAW, YAW] <= settings.yaw_limit**2
    valid &= (cars.age <= settings.lidar_timeout) & (cars.refused < min(3, settings.lost_after))
    pose = np.stack([x, y, yaw], axis=-1)
    velocity = np.stack([v * np.cos(beta), v * np.sin(beta)], axis=-1)
    return BatchEstimate(pose, velocity, v.copy(), beta.copy(), cars.bicycle[:, R].copy(), covariance, valid)


def _correct(
  state: Array, covariance: Array, rows: tuple[int, ...], innovation: Array, noise: Array, which: Mask
) -> tuple[Array, Array]:
  """Joint update of the cars in `which`, for measurements of `rows` with variances `noise` (N, k)."""
  column = covariance[:, :, rows]
  total = column[:, rows, :] + noise[:, :, None] * np.eye(len(rows))
  gain = column @ np.linalg.inv(total) * which[:, None, None]
  keep = np.eye(state.shape[1]) - gain @ np.eye(state.shape[1])[list(rows)]  # Joseph form, as filterpy's
  updated = keep @ covariance @ keep.transpose(0, 2, 1) + (gain * noise[:, None, :]) @ gain.transpose(0, 2, 1)
  return state + (gain @ innovation[..., None])[..., 0], updated
