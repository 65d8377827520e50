"""N cars on a path under speed control, one control period after the other: the loop of training and of evaluation.

Plant, steering linkage, sensors and filter, speed control, progress on the path. Who steers, and what it is worth,
is not decided here.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_twin.estimation.estimate import BatchEstimate
from qcar_twin.estimation.observer import POSE, VELOCITY, YAW_RATE, Observer
from qcar_twin.paths import Errors, Path
from qcar_twin.plant import Simulation
from qcar_twin.recent import Recent
from qcar_twin.slow_means import remember

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
ESTIMATED, TRUE = 0, 1  # rows of what is known twice


class SpeedControl(Protocol):
  """A speed controller of N cars."""

  def restart(self, which: Mask, speed: Array) -> None:
    """Take over some cars again at speeds (N,), m/s."""
    ...

  def voltage(self, speed: Array, target: ArrayLike, period: float) -> Array:
    """Command of the drive, in its unit, (N,), for measured and wanted speeds, m/s."""
    ...


class Linkage:
  """What happens to the steering commands of N cars on their way: delay, first-order lag, gain, offset.

  Args:
    count: N.
    delay: s, rounded to control periods.  lag: time constant, s.
    period: s.
    gain, offset: - and rad, numbers or (N,).

  Attributes:
    gain, offset: of each car, (N,).
  """

  def __init__(
    self, count: int, delay: float, lag: float, period: float, gain: ArrayLike = 1.0, offset: ArrayLike = 0.0
  ):
    self._share = 1.0 - math.exp(-period / lag) if lag > 0.0 else 1.0
    self._line = np.zeros((round(delay / period), count))
    self._angle = np.zeros(count)
    self.gain, self.offset = (np.array(np.broadcast_to(a, count), dtype=np.float64) for a in (gain, offset))

  def restart(self, which: Mask, gain: Array, offset: Array) -> None:
    """Wheels straight, nothing under way, another gain and offset, (N,), in some cars."""
    self._line = np.where(which, 0.0, self._line)
    self._angle = np.where(which, 0.0, self._angle)
    self.gain, self.offset = np.where(which, gain, self.gain), np.where(which, offset, self.offset)

  def pass_on(self, steering: Array) -> Array:
    """The command the plant gets, rad, (N,)."""
    line = np.concatenate([self._line, steering[None]])
    self._line = line[1:]
    self._angle = self._angle + self._share * (line[0] - self._angle)
    return self.gain * self._angle + self.offset


@dataclasses.dataclass(frozen=True)
class Course:
  """What is followed: a path from its start, at a speed, m/s, a number or (N,), that a speed controller holds from now
  on; period in s."""

  path: Path
  speed: ArrayLike
  period: float


class DrivenCars:
  """N cars under way.

  Args:
    course: what is followed; another one, such as of another speed, may be set while the cars drive.
    plant: the cars, begun.
    linkage: None for commands that reach the plant as they are.
    observer: what the cars know of themselves.
    speed_control: made from initial speeds (N,), m/s.
    arc_length: where on the path the cars are, m, (N,); at its start without it.

  Attributes:
    commands: of drive and steering in the last period, in the drive's unit and rad, (N, 2).
    steering: commanded, rad, (N,).  mute: whose last command was no number, (N,).  estimate: of the cars.
    errors: relative to the path, (2, N) each: as estimated, and true.  arc_length: as estimated, and true, m, (2, N).
    past: slow means of steering command and path curvature, rad and 1/m, (N, 2).
    recent: the last second, value by value.
  """

  def __init__(
    self,
    course: Course,
    plant: Simulation,
    linkage: Linkage | None,
    observer: Observer,
    speed_control: Callable[[Array], SpeedControl],
    arc_length: Array | None = None,
  ):
    self.course, self.plant, self.linkage, self.observer = course, plant, linkage, observer
    count = len(plant.signals)
    self.commands, self.steering, self.mute = np.zeros((count, 2)), np.zeros(count), np.zeros(count, dtype=bool)
    self.past = np.zeros((count, 2))
    self.arc_length = np.tile(np.zeros(count) if arc_length is None else arc_length, (2, 1))
    self.estimate: BatchEstimate = observer.begin(self.signals)
    self._speed_control = speed_control(self.estimate.speed)
    self.errors = self._look(np.ones(count, dtype=bool))
    self.recent = Recent(self._now(), course.period)

  @property
  def signals(self) -> Array:
    """True, (N, 10)."""
    return self.plant.signals

  @property
  def target(self) -> Array:
    """Speed that is held, the course's, m/s, (N,)."""
    return np.array(np.broadcast_to(self.course.speed, len(self.steering)), dtype=np.float64)

  @property
  def speeds(self) -> Array:
    """As estimated and true, m/s, (2, N)."""
    return np.stack([np.nan_to_num(self.estimate.speed), np.hypot(*self.signals[:, VELOCITY].T)])

  def restart(self, which: Mask, arc_length: Array | float = 0.0, target: Array | None = None) -> None:
    """Let some cars, (N,), that have been put to the path at an arc length, m, begin again; at other speeds to hold,
    m/s, (N,), where they are given."""
    if target is not None:
      self.course = dataclasses.replace(self.course, speed=np.where(which, target, self.target))
    self.steering, self.mute = np.where(which, 0.0, self.steering), self.mute & ~which
    self.commands = np.where(which[:, None], 0.0, self.commands)
    self.past = np.where(which[:, None], 0.0, self.past)
    self.arc_length = np.where(which, arc_length, self.arc_length)
    self.estimate = self.observer.begin(self.signals, which)
    self._speed_control.restart(which, self.estimate.speed)
    fresh, names = self._look(which), [field.name for field in dataclasses.fields(Errors)]
    self.errors = Errors(*(put(getattr(self.errors, name), which, getattr(fresh, name)) for name in names))
    self.recent.restart(which, self._now())

  def step(self, steering: Array) -> None:
    """Drive one control period with steering commands (N,), rad. A car whose command is no finite number holds the one
    before, and is `mute`: one NaN must not spoil wheels, means and filter for good."""
    course = self.course
    self.mute = ~np.isfinite(steering)
    self.steering = steering = np.where(self.mute, self.steering, steering)
    voltage = self._speed_control.voltage(np.nan_to_num(self.estimate.speed), self.target, course.period)
    self.commands = np.stack([voltage, steering], axis=-1)
    self.observer.command(self.commands)
    reaching = self.linkage.pass_on(steering) if self.linkage else steering
    self.estimate = self.observer.observe(self.plant.step(np.stack([voltage, reaching], axis=-1)))
    self.errors = self._look(np.ones(len(steering), dtype=bool), moving=True)
    self.past = remember(self.past, steering, self.errors.curvature[ESTIMATED], course.period)
    self.recent.add(self._now())

  def _now(self) -> Array:
    """What is remembered, (N, 4)."""
    seen = one_of(self.errors, ESTIMATED)
    return np.stack([seen.cross_track, seen.heading, self.steering, seen.curvature], axis=-1)

  def _look(self, which: Mask, moving: bool = False) -> Errors:
    """Errors of k of the cars, (2, k), at the nearest path point, searched around where the paper's ds/dt puts it."""
    path, signals, estimate = self.course.path, self.signals[which], self.estimate
    pose = np.nan_to_num(np.stack([estimate.pose[which], signals[:, POSE]]))
    velocity = np.nan_to_num(np.stack([estimate.velocity[which], signals[:, VELOCITY]]))
    rate = np.nan_to_num(np.stack([estimate.yaw_rate[which], signals[:, YAW_RATE]]))
    near = self.arc_length[:, which]
    if moving:
      near = near + self.course.period * path.errors(near, pose, velocity, rate).arc_rate
    arc_length = path.nearest(pose[..., 0], pose[..., 1], near=near)
    self.arc_length = put(self.arc_length, which, arc_length)
    return path.errors(arc_length, pose, velocity, rate)


def put(values: Array, which: Mask, fresh: Array) -> Array:
  """Values (2, N) with those of some cars replaced, (2, k); what was there is left as it is."""
  new = values.copy()
  new[:, which] = fresh
  return new


def one_of(errors: Errors, which: int | slice) -> Errors:
  """Errors at an index of their first axis, such as ESTIMATED or TRUE of (2, N)."""
  return Errors(*(getattr(errors, field.name)[which] for field in dataclasses.fields(Errors)))
