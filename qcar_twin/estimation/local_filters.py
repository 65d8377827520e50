"""The two local filters of one car and their master: one control period at a time, no clock.

EKF_BM is the single track (position, speed, yaw, sideslip, yaw rate) with lidar, encoder and gyro; EKF_PM is
the point mass driven by the accelerometer, with the lidar's position. The master fuses their positions
and feeds nothing back.
"""

import dataclasses
import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from qcar_twin.estimation.estimate import Estimate, Snapshot
from qcar_twin.estimation.kalman import LocalFilter
from qcar_twin.estimation.master import fuse_positions
from qcar_twin.estimation.models import (
  BETA,
  YAW,
  R,
  V,
  X,
  Y,
  bicycle_step,
  cg_acceleration,
  fill_jacobian,
  lateral_acceleration,
  point_step,
)
from qcar_twin.estimation.monitor import Monitor, SpeedWatch
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.estimation.timeline import POSE, Slot
from qcar_twin.single_track import Car

Array = NDArray[np.float64]
START_STD = (0.1, 0.1, 0.5, 0.1, 0.1, 0.5)  # m, m, m/s, rad, rad, rad/s: of EKF_BM after the first fix
POINT_START_STD = (0.1, 0.1, 0.5, 0.5)  # m, m, m/s, m/s
LOST_STD = 0.5  # m and rad, added to a pose that steady fixes contradict


@dataclasses.dataclass(slots=True)
class Held:
  """What is carried from period to period beside the two filters' states."""

  voltage: float = 0.0  # V
  steering: float = 0.0  # command, rad
  angle: float = 0.0  # of the road wheels, after the servo's lag, rad
  accel: tuple[float, float] = (0.0, 0.0)  # at the IMU, m/s^2
  accel_age: float = math.inf  # s
  monitor: Monitor = dataclasses.field(default_factory=Monitor)
  watch: SpeedWatch = dataclasses.field(default_factory=SpeedWatch)

  def copy(self) -> "Held":
    """An independent copy."""
    monitor, watch = self.monitor.copy(), self.watch.copy()
    return Held(self.voltage, self.steering, self.angle, self.accel, self.accel_age, monitor, watch)


class LocalFilters:
  """EKF_BM, EKF_PM and the master of one car.

  Args:
    car: the identified single-track model.
    settings: noise, gates, limits.

  Attributes:
    refused: how often a measurement was not used, by (channel, reason).
    nis: of the last lidar fix in EKF_BM and in EKF_PM.
    evidence: log likelihood of all fixes in EKF_BM and in EKF_PM (constants left out), what is beyond a gate
      counting as if on its edge; for fitting the noise.
  """

  def __init__(self, car: Car, settings: FilterSettings):
    self.settings = settings
    self.car = Car(**{f.name: float(np.asarray(getattr(car, f.name))) for f in dataclasses.fields(Car)})
    self.refused: Counter[tuple[str, str]] = Counter()
    self.nis = (math.nan, math.nan)
    self.evidence = [0.0, 0.0]
    self._bicycle = LocalFilter(np.zeros(6), np.eye(6), settings.bicycle_noise)
    self._point = LocalFilter(np.zeros(4), np.eye(4), settings.point_noise)
    self._identity = np.eye(6)
    self._point_transition = np.eye(4)
    self._point_transition[0, 2] = self._point_transition[1, 3] = settings.period
    lag = settings.steering_lag
    self._servo = 1.0 - math.exp(-settings.period / lag) if lag > 0.0 else 1.0
    self._variance = {"speed": settings.speed_std**2, "yaw_rate": settings.yaw_rate_std**2}
    both = np.array([self._variance["speed"], self._variance["yaw_rate"]])
    self._motion = {1: ((V,), np.diag(both[:1])), 2: ((R,), np.diag(both[1:])), 3: ((V, R), np.diag(both))}
    self._scalar_limit = settings.limits[0]
    self._assumed_score = settings.score * settings.score_full / 100.0
    self._held = Held()

  def start(self, pose: tuple[float, float, float], speed: float, std: float) -> None:
    """Begin at a pose, m, m, rad, with standard deviation `std`, and a speed, m/s."""
    x, y, yaw = pose
    spread = np.array([std, std, START_STD[V], std, *START_STD[BETA:]])
    self._bicycle.restore((np.array([x, y, speed, yaw, 0.0, 0.0]), np.diag(spread**2)))
    point = np.array([x, y, speed * math.cos(yaw), speed * math.sin(yaw)])
    self._point.restore((point, np.diag(np.square([std, std, *POINT_START_STD[2:]]))))
    self._held = Held()

  @property
  def outcome(self) -> tuple[Snapshot, Snapshot, Held]:
    """All there is to know to go on from here."""
    return self._bicycle.snapshot, self._point.snapshot, self._held.copy()

  def restore(self, outcome: tuple[Snapshot, Snapshot, Held]) -> None:
    """Go back to an earlier outcome."""
    bicycle, point, held = outcome
    self._bicycle.restore(bicycle)
    self._point.restore(point)
    self._held = held.copy()

  def step(self, before: Slot, now: Slot, time: float) -> None:
    """One period: the inputs of the slot before, the measurements of the slot at its end, `time` s."""
    self._take_inputs(before)
    self._predict()
    self._correct_motion(now)
    if now.pose is not None:
      self._correct_pose(now.pose, now.offset, time)

  def _take_inputs(self, slot: Slot) -> None:
    """Inputs that act from this slot until the next."""
    held = self._held
    if slot.motor_voltage is not None:
      held.voltage = slot.motor_voltage
    if slot.steering_command is not None:
      held.steering = slot.steering_command
    if slot.accel_x is not None and slot.accel_y is not None:
      held.accel, held.accel_age = (slot.accel_x, slot.accel_y), 0.0

  def _predict(self) -> None:
    held, period, bicycle = self._held, self.settings.period, self._bicycle
    held.angle += self._servo * (held.steering - held.angle)
    held.accel_age += period
    before = bicycle.x.tolist()
    held.monitor.drive(before[V], period)
    following, entries = bicycle_step(before, held.voltage, held.angle, self.car, period)
    transition = self._identity.copy()
    fill_jacobian(transition, entries, period)
    bicycle.predict_to(np.array(following), transition)
    accel = cg_acceleration(held.accel, before[R], (self.settings.imu_x, self.settings.imu_y))
    course = before[YAW] + 0.5 * period * before[R]
    self._point.predict_to(np.array(point_step(self._point.x.tolist(), accel, course, period)), self._point_transition)
    if not self._point_on:
      self._restart_point()

  @property
  def _point_on(self) -> bool:
    return self._held.accel_age <= self.settings.accel_timeout and not self.settings.central

  def _restart_point(self) -> None:
    """Put EKF_PM where EKF_BM is: it has lost its accelerometer or its way."""
    x, y, v, yaw, beta, _ = self._bicycle.x.tolist()
    covariance = np.diag(np.square(POINT_START_STD))
    covariance[:2, :2] = self._bicycle.P[:2, :2]
    course = yaw + beta
    self._point.restore((np.array([x, y, v * math.cos(course), v * math.sin(course)]), covariance))

  def _correct_motion(self, slot: Slot) -> None:
    """Encoder and gyro, each behind its own gate."""
    bicycle, watch = self._bicycle, self._held.watch
    speed, yaw_rate = slot.speed, slot.yaw_rate
    if speed is not None:
      speed /= 1.0 + self.settings.front_drive_share * (1.0 / math.cos(self._held.angle) - 1.0)
      watch.travel(speed, self.settings.period)
    speed = None if watch.doubted else self._gated("speed", speed, V)
    yaw_rate = self._gated("yaw_rate", yaw_rate, R)
    given = (speed is not None) + 2 * (yaw_rate is not None)
    if given:
      rows, noise = self._motion[given]
      innovation = [value for value in (speed, yaw_rate) if value is not None]
      bicycle.correct(rows, innovation, noise)
    if self.settings.central and slot.accel_y is not None:
      self._correct_acceleration(slot.accel_y)

  def _correct_acceleration(self, accel_y: float) -> None:
    """The centralised filter's use of the accelerometer: a_y = (F_front + F_rear) / m."""
    state = self._bicycle.x.tolist()
    _, measured = cg_acceleration((0.0, accel_y), state[R], (0.0, self.settings.imu_y))
    expected, slopes = lateral_acceleration(tuple(state), self._held.angle, self.car)
    selector = np.zeros((1, 6))
    selector[0, [V, BETA, R]] = slopes
    noise = np.array([[self.settings.accel_std**2]])
    variance = (selector @ self._bicycle.P @ selector.T + noise).item()
    if (measured - expected) ** 2 <= self._scalar_limit * variance:
      self._bicycle.correct_with(selector, np.array([measured - expected]), noise)

  def _gated(self, name: str, value: float | None, row: int) -> float | None:
    """Innovation of one scalar, None where there is no sample or it does not fit."""
    if value is None:
      return None
    innovation = value - self._bicycle.x.item(row)
    variance = self._bicycle.P.item(row, row) + self._variance[name]
    if innovation * innovation <= self._scalar_limit * variance:
      return innovation
    self.refused[name, "gate"] += 1
    return None

  def _correct_pose(self, pose: dict[str, float], offset: float, time: float) -> None:
    """A lidar fix into both filters; `offset` is its stamp after the slot, s."""
    settings, held = self.settings, self._held
    names = [name for name in POSE if name in pose]
    position, yaw = settings.pose_noise(pose.get("pose_score", self._assumed_score))
    noise = np.diag([yaw if name == "pose_yaw" else position for name in names])
    measured = np.array([pose[name] for name in names])
    if "pose_x" in pose and "pose_y" in pose:
      held.watch.compare(time + offset, pose["pose_x"], pose["pose_y"], math.sqrt(position))
    # without lidar EKF_PM soon believes anything, so a fix must pass the gate of EKF_BM first
    if self._fix_bicycle(names, measured, noise, offset) and self._point_on:
      self._fix_point(names, measured, noise, offset)

  def _fix_bicycle(self, names: list[str], measured: Array, noise: Array, offset: float) -> bool:
    bicycle, settings, monitor = self._bicycle, self.settings, self._held.monitor
    x, y, v, yaw, beta, r = bicycle.x.tolist()
    course = yaw + beta
    ahead = {"pose_x": offset * v * math.cos(course), "pose_y": offset * v * math.sin(course), "pose_yaw": offset * r}
    rows = tuple({"pose_x": X, "pose_y": Y, "pose_yaw": YAW}[name] for name in names)
    innovation = measured - bicycle.x[list(rows)] - np.array([ahead[name] for name in names])
    if "pose_yaw" in names:
      innovation[-1] = math.remainder(innovation[-1], math.tau)
    if not self._fits(bicycle, rows, innovation, noise / settings.sharing[0], 0):
      self.refused["pose", "gate"] += 1
      where = dict(zip(names, measured.tolist(), strict=True))
      if monitor.refuse(where.get("pose_x", x), where.get("pose_y", y)) < settings.lost_after:
        return False
      widened = bicycle.P.copy()
      widened[[X, Y, YAW], [X, Y, YAW]] += LOST_STD**2
      bicycle.restore((bicycle.x, widened))
    bicycle.correct(rows, innovation, noise / settings.sharing[0])
    monitor.accept()
    return True

  def _fix_point(self, names: list[str], measured: Array, noise: Array, offset: float) -> None:
    """A fix EKF_BM has accepted but EKF_PM cannot is the accelerometer's fault: start EKF_PM afresh."""
    point = self._point
    rows = tuple(row for row, name in enumerate(("pose_x", "pose_y")) if name in names)
    if not rows:
      return
    which = [names.index(("pose_x", "pose_y")[row]) for row in rows]
    innovation = measured[which] - point.x[list(rows)] - offset * point.x[[row + 2 for row in rows]]
    share = noise[np.ix_(which, which)] / self.settings.sharing[1]
    if self._fits(point, rows, innovation, share, 1):
      point.correct(rows, innovation, share)
    else:
      self.refused["pose", "gate of the point filter"] += 1
      self._restart_point()

  def _fits(self, local: LocalFilter, rows: tuple[int, ...], innovation: Array, noise: Array, which: int) -> bool:
    covariance = local.innovation_covariance(rows, noise)
    nis = float(innovation @ np.linalg.solve(covariance, innovation))
    self.nis = (nis, self.nis[1]) if which == 0 else (self.nis[0], nis)
    limit = self.settings.limits[len(rows) - 1]
    self.evidence[which] -= 0.5 * (min(nis, limit) + math.log(np.linalg.det(covariance)))
    return nis <= limit

  def report(self, time: float) -> Estimate:
    """The master's position and EKF_BM's motion, as an estimate at `time` s."""
    x, y, v, yaw, beta, r = self._bicycle.x.tolist()
    covariance = self._bicycle.P
    position, spread = (x, y), (covariance.item(0), covariance.item(1), covariance.item(7))
    point = None
    if self._point_on:
      point = self._point.snapshot
      other = point[1]
      position, spread = fuse_positions(
        position, spread, (point[0].item(0), point[0].item(1)), (other.item(0), other.item(1), other.item(5))
      )
    reasons = self._doubts(spread, covariance.item(21))
    return Estimate(time, *position, yaw, v, beta, r, spread, self._bicycle.snapshot, point, reasons, self._warnings())

  def _warnings(self) -> tuple[str, ...]:
    warnings = []
    if self._held.watch.doubted:
      warnings.append("the encoder contradicts the poses and is left out")
    if not self._point_on and not self.settings.central:
      warnings.append("no accelerometer: the point filter is left out")
    return tuple(warnings)

  def _doubts(self, spread: tuple[float, float, float], yaw_variance: float) -> tuple[str, ...]:
    settings, monitor = self.settings, self._held.monitor
    reasons = []
    if max(spread[0], spread[2]) > settings.position_limit**2:
      reasons.append(f"position known to {math.sqrt(max(spread[0], spread[2])):.2f} m only")
    if yaw_variance > settings.yaw_limit**2:
      reasons.append(f"yaw known to {math.sqrt(yaw_variance):.2f} rad only")
    if monitor.age > settings.lidar_timeout:
      reasons.append(f"no accepted pose for {monitor.age:.1f} s")
    if monitor.refused >= min(3, settings.lost_after):
      reasons.append(f"the last {monitor.refused} poses contradict the estimate")
    return tuple(reasons)
