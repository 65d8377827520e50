"""The federated extended Kalman filter of one car, online: the paper's section on EKFs, no-reset mode.

EKF_BM (single track: position, speed, yaw, sideslip, yaw rate) and EKF_PM (point mass driven by the
accelerometer) run side by side; the master fuses their positions and feeds nothing back. Measurements of
any rate may come late and out of order: every period's inputs, measurements and outcome are kept for a
while, and a late arrival makes the filter start over from its period.
"""

import dataclasses
import math
from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.estimation.estimate import Estimate, no_estimate
from qcar_twin.estimation.kalman import LocalFilter
from qcar_twin.estimation.master import fuse_positions
from qcar_twin.estimation.models import BETA, YAW, R, V, X, Y, bicycle_step, cg_acceleration, fill_jacobian, point_step
from qcar_twin.estimation.monitor import Monitor, SpeedWatch
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.estimation.timeline import POSE, Slot, Timeline
from qcar_twin.recording import COMMANDS, nearest
from qcar_twin.single_track import Car

Array = NDArray[np.float64]
INPUTS = (*COMMANDS, "accel_x", "accel_y")  # act from their slot until the next
TAKES = (*INPUTS, "motor_speed", "speed", "yaw_rate", *POSE, "pose_score")
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
    monitor, watch = self.monitor.copy(), self.watch.copy()
    return Held(self.voltage, self.steering, self.angle, self.accel, self.accel_age, monitor, watch)


class FederatedFilter:
  """EKF_BM, EKF_PM and their master for one car.

  Call `update` with whatever arrives, `estimate` once per control period.

  Args:
    car: the identified single-track model.
    settings: noise, gates, limits.

  Attributes:
    refused: how often a measurement was not used, by (channel, reason); recounted when the past is filtered again.
    nis: of the last lidar fix in EKF_BM and in EKF_PM.
  """

  def __init__(self, car: Car, settings: FilterSettings | None = None):
    self.settings = settings or FilterSettings()
    self.car = Car(**{f.name: float(np.asarray(getattr(car, f.name))) for f in dataclasses.fields(Car)})
    self.refused: Counter[tuple[str, str]] = Counter()
    self.nis = (math.nan, math.nan)
    self._bicycle = LocalFilter(np.zeros(6), np.eye(6), self.settings.bicycle_noise)
    self._point = LocalFilter(np.zeros(4), np.eye(4), self.settings.point_noise)
    self._point_transition = np.eye(4)
    self._point_transition[0, 2] = self._point_transition[1, 3] = self.settings.period
    lag = self.settings.steering_lag
    self._servo = 1.0 - math.exp(-self.settings.period / lag) if lag > 0.0 else 1.0
    self._scale = {  # where a sample is kept, what is subtracted from it, what it is multiplied by
      **{name: (name, 0.0, 1.0) for name in (*COMMANDS, "speed")},
      **{name: (name, getattr(self.settings, f"{name}_bias"), 1.0) for name in ("accel_x", "accel_y", "yaw_rate")},
      "motor_speed": ("speed", 0.0, self.car.rolling_radius),
    }
    self._identity = np.eye(6)
    self._variance = {"speed": self.settings.speed_std**2, "yaw_rate": self.settings.yaw_rate_std**2}
    both = np.array([self._variance["speed"], self._variance["yaw_rate"]])
    self._motion = {1: ((V,), np.diag(both[:1])), 2: ((R,), np.diag(both[1:])), 3: ((V, R), np.diag(both))}
    self._scalar_limit = self.settings.limits[0]
    self._held = Held()
    self._timeline = Timeline(self.settings.period, self.settings.buffer)
    self._started: int | None = None  # slot of the first pose
    self._current = 0  # last slot passed
    self._dirty: int | None = None  # first slot whose outcome a late arrival has spoilt

  # -- what arrives ------------------------------------------------------------------------------

  def update(self, time: float, channel: str, value: float) -> None:
    """Take one sample with the time at which it was measured, s; the order of arrival does not matter.

    Not-finite values, repeated stamps and samples older than the buffer are refused and counted.

    Raises:
      KeyError: a channel the filter has no use for, with the nearest one.
    """
    if channel not in TAKES:
      raise KeyError(f"the filter takes no channel '{channel}'{nearest(channel, TAKES)}")
    if not (math.isfinite(time) and math.isfinite(value)):
      self.refused[channel, "not finite"] += 1
      return
    index, offset = self._timeline.place(time)
    reason = self._out_of_reach(index, channel)
    if reason is None and not self._put(self._timeline[index], channel, value, offset):
      reason = "repeated"
    if reason is not None:
      self.refused[channel, reason] += 1
    elif index <= self._current and self._started is not None:
      spoilt = index + (channel in INPUTS)
      if spoilt <= self._current:
        self._dirty = spoilt if self._dirty is None else min(self._dirty, spoilt)

  def _out_of_reach(self, index: int, channel: str) -> str | None:
    timeline = self._timeline
    if not timeline.keeps(index):
      return "too late"
    if self._started is None:
      return None
    if self._current - timeline.reach <= index <= self._current + timeline.reach:
      return None if index > self._started or (index == self._started and channel in INPUTS) else "before the start"
    return "too late" if index < self._current else "in the future"

  def _put(self, slot: Slot, channel: str, value: float, offset: float) -> bool:
    """Store a sample; False when the slot already holds one. The last of two commands counts."""
    if channel not in self._scale:
      if slot.pose is None:
        slot.pose, slot.offset = {}, offset
      fresh = channel not in slot.pose
      slot.pose.setdefault(channel, value)
      return fresh
    name, bias, scale = self._scale[channel]
    fresh = getattr(slot, name) is None or channel in COMMANDS
    if fresh:
      setattr(slot, name, (value - bias) * scale)
    return fresh

  # -- the clock ---------------------------------------------------------------------------------

  def start(self, time: float, pose: tuple[float, float, float], speed: float = 0.0, std: float = 0.01) -> None:
    """Start from a known pose (m, m, rad; standard deviation `std`) and speed (m/s) instead of the first fix."""
    index, _ = self._timeline.place(time)
    x, y, yaw = pose
    spread = np.array([std, std, START_STD[V], std, *START_STD[BETA:]])
    self._bicycle.restore((np.array([x, y, speed, yaw, 0.0, 0.0]), np.diag(spread**2)))
    point = np.array([x, y, speed * math.cos(yaw), speed * math.sin(yaw)])
    self._point.restore((point, np.diag(np.square([std, std, *POINT_START_STD[2:]]))))
    self._held = Held()
    self._timeline[index].outcome = self._outcome()
    self._started, self._current, self._dirty = index, index, None

  def estimate(self, time: float) -> Estimate:
    """Advance to a time, s, starting over from where late arrivals have changed the past, and report."""
    target, _ = self._timeline.place(time)
    if self._started is None:
      self._start_at_first_fix()
    if self._started is None:
      return no_estimate(time, "no pose has arrived yet")
    first = self._current + 1
    if self._dirty is not None:
      first = self._dirty
      self._restore(self._timeline[first - 1].outcome)
    for index in range(first, max(target, self._current) + 1):
      self._step(index)
    self._current, self._dirty = max(target, self._current), None
    return self._report(time)

  def _start_at_first_fix(self) -> None:
    index = self._timeline.first_fix()
    if index is not None:
      slot = self._timeline[index]
      pose = slot.pose or {}
      self.start(self._timeline.time(index), tuple(pose[name] for name in POSE), slot.speed or 0.0, START_STD[0])

  def _outcome(self) -> tuple[Any, Any, Held]:
    return self._bicycle.snapshot, self._point.snapshot, self._held.copy()

  def _restore(self, outcome: tuple[Any, Any, Held]) -> None:
    bicycle, point, held = outcome
    self._bicycle.restore(bicycle)
    self._point.restore(point)
    self._held = held.copy()

  # -- one period --------------------------------------------------------------------------------

  def _step(self, index: int) -> None:
    self._take_inputs(self._timeline[index - 1])
    slot = self._timeline[index]
    self._predict()
    self._correct_motion(slot)
    if slot.pose is not None:
      self._correct_pose(slot.pose, slot.offset, index)
    slot.outcome = self._outcome()

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
    held.monitor.age += period
    before = bicycle.x.tolist()
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
    return self._held.accel_age <= self.settings.accel_timeout

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
      watch.travel(speed, self.settings.period)
    speed = None if watch.doubted else self._gated("speed", speed, V)
    yaw_rate = self._gated("yaw_rate", yaw_rate, R)
    given = (speed is not None) + 2 * (yaw_rate is not None)
    if given:
      rows, noise = self._motion[given]
      innovation = [value for value in (speed, yaw_rate) if value is not None]
      bicycle.correct(rows, np.array(innovation), noise)

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

  def _correct_pose(self, pose: dict[str, float], offset: float, index: int) -> None:
    """A lidar fix into both filters; `offset` is its stamp after the slot, s."""
    settings, held = self.settings, self._held
    names = [name for name in POSE if name in pose]
    position, yaw = settings.pose_noise(pose.get("pose_score", settings.score))
    noise = np.diag([yaw if name == "pose_yaw" else position for name in names])
    measured = np.array([pose[name] for name in names])
    if "pose_x" in pose and "pose_y" in pose:
      held.watch.compare(self._timeline.time(index) + offset, pose["pose_x"], pose["pose_y"])
    accepted = self._fix_bicycle(names, measured, noise, offset)
    if self._point_on:
      self._fix_point(names, measured, noise, offset, accepted)

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
      if monitor.refuse(*(innovation[:2] if len(rows) > 1 else (innovation[0], 0.0))) < settings.lost_after:
        return False
      widened = bicycle.P.copy()
      widened[[X, Y, YAW], [X, Y, YAW]] += LOST_STD**2
      bicycle.restore((bicycle.x, widened))
    bicycle.correct(rows, innovation, noise / settings.sharing[0])
    monitor.accept()
    return True

  def _fix_point(self, names: list[str], measured: Array, noise: Array, offset: float, accepted: bool) -> None:
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
    elif accepted:
      self.refused["pose", "gate of the point filter"] += 1
      self._restart_point()

  def _fits(self, local: LocalFilter, rows: tuple[int, ...], innovation: Array, noise: Array, which: int) -> bool:
    covariance = local.innovation_covariance(rows, noise)
    nis = float(innovation @ np.linalg.solve(covariance, innovation))
    self.nis = (nis, self.nis[1]) if which == 0 else (self.nis[0], nis)
    return nis <= self.settings.limits[len(rows) - 1]

  # -- what is known -----------------------------------------------------------------------------

  def _report(self, time: float) -> Estimate:
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
    return Estimate(time, *position, yaw, v, beta, r, spread, self._bicycle.snapshot, point, reasons)

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
    if self._held.watch.doubted:
      reasons.append("the encoder contradicts the poses")
    return tuple(reasons)
