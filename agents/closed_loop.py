"""Closed loop of N cars on a path: plant, observer, speed controller, steering controller, every 10 ms."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from agents.control import Body, Controller, Situation
from agents.speed import SpeedController, SpeedGains
from qcar_twin.estimation.batch import BatchEstimate
from qcar_twin.estimation.observer import Observer
from qcar_twin.past import remember
from qcar_twin.paths import Path

Array = NDArray[np.float64]
LOST = 0.5  # m from the path: the run is over


@dataclasses.dataclass(frozen=True)
class Actuation:
  """What happens to a steering command on its way, for plants that have no servo of their own.

  Attributes:
    delay: s, rounded to control periods.  lag: first-order time constant, s.
    gain, offset: of the linkage, - and rad; numbers or (N,).
  """

  delay: float = 0.02
  lag: float = 0.04
  gain: float | Array = 1.0
  offset: float | Array = 0.0


class Servo:
  """The actuation of N cars under way."""

  def __init__(self, actuation: Actuation, count: int, period: float):
    self._share = 1.0 - math.exp(-period / actuation.lag) if actuation.lag > 0.0 else 1.0
    self._line = [np.zeros(count) for _ in range(round(actuation.delay / period))]
    self._angle = np.zeros(count)
    self._actuation = actuation

  def pass_on(self, steering: Array) -> Array:
    """The command the plant gets, rad, (N,)."""
    self._line.append(steering)
    self._angle = self._angle + self._share * (self._line.pop(0) - self._angle)
    return self._actuation.gain * self._angle + self._actuation.offset


@dataclasses.dataclass(frozen=True)
class Task:
  """What is driven.

  Attributes:
    path: followed from its start.  speed: m/s, from the first instant.  laps: of a closed path.
    lock: of the steering, rad.  offset, heading: start relative to the path, m and rad, numbers or (N,).
    actuation: of the steering command; None when the plant has its own servo.
  """

  path: Path
  speed: float = 0.5
  laps: int = 1
  lock: float = 0.5236
  offset: float | Array = 0.0
  heading: float | Array = 0.0
  actuation: Actuation | None = None

  @property
  def distance(self) -> float:
    """Arc length at which a run is finished, m."""
    return self.path.length * (self.laps if self.path.closed else 1)


@dataclasses.dataclass(frozen=True)
class Drive:
  """N runs, T control periods; row k is the instant at which commands k are given.

  Attributes:
    path, period: of the runs; s.
    signals: true, (T, N, 10).  commands: V and rad, (T, N, 2).
    pose, velocity, sideslip_angle: as estimated, (T, N, 3), (T, N, 2), (T, N).
    valid: whether the estimate says it may be used, (T, N).
    cross_track: true error, m, (T, N).  arc_length: true, m, (T, N).
    under_way: before the end and not lost, (T, N).  finished: (N,).
  """

  path: Path
  period: float
  signals: Array
  commands: Array
  pose: Array
  velocity: Array
  sideslip_angle: Array
  valid: NDArray[np.bool_]
  cross_track: Array
  arc_length: Array
  under_way: NDArray[np.bool_]
  finished: NDArray[np.bool_]

  @property
  def time(self) -> Array:
    """(T,), s."""
    return np.arange(len(self.signals), dtype=np.float64) * self.period

  def cars(self, which: slice) -> "Drive":
    """The same drive with some of its cars."""
    arrays = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
    picked = {n: v[:, which] if v.ndim > 1 else v[which] for n, v in arrays.items() if isinstance(v, np.ndarray)}
    return dataclasses.replace(self, **picked)


def start_states(task: Task, count: int) -> Array:
  """Where N cars start, (N, 7): on the path, offset and turned as the task says, at speed, wheels straight."""
  x, y, yaw = task.path.start
  offset = np.broadcast_to(np.asarray(task.offset, dtype=np.float64), count)
  heading = np.broadcast_to(np.asarray(task.heading, dtype=np.float64), count)
  zero = np.zeros(count)
  pose = x - offset * math.sin(yaw), y + offset * math.cos(yaw), yaw + heading
  return np.stack([*pose, zero + task.speed, zero, zero, zero], axis=-1)


def drive(
  plant: Body, theta: Array, controller: Controller, speed_gains: SpeedGains, observer: Observer, task: Task
) -> Drive:
  """Follow a path with N cars, plant parameters (N, P), until all have finished or a quarter more time has gone.

  The reference point is the nearest one, searched around where the paper's ds/dt puts it.
  """
  count, period = len(theta), plant.period
  simulation = plant.begin(np.asarray(theta, dtype=np.float64), start_states(task, count))
  servo = Servo(task.actuation, count, period) if task.actuation else None
  estimate = observer.begin(simulation.signals)
  pedal = SpeedController(speed_gains, estimate.speed)
  arc = np.zeros(count)
  steering, past = np.zeros(count), np.zeros((count, 2))
  log: list[tuple[Array, Array, BatchEstimate]] = []
  for _ in range(int(1.25 * task.distance / (task.speed * period))):
    arc, situation = _situation(task, estimate, arc, steering, past, period)
    steering = np.clip(controller.steer(situation), -task.lock, task.lock)
    gone = ~np.isfinite(steering) | (arc >= task.distance)
    steering = np.where(gone, 0.0, steering)
    voltage = pedal.voltage(estimate.speed, task.speed, period)
    commands = np.stack([np.nan_to_num(voltage), steering], axis=-1)
    log.append((simulation.signals.copy(), commands, estimate))
    if np.all(arc >= task.distance):
      break
    observer.command(commands)
    applied = commands.copy()
    if servo:
      applied[:, 1] = servo.pass_on(steering)
    estimate = observer.observe(simulation.step(applied))
    past = situation.past
  return _finish(task, period, log)


def _situation(
  task: Task, estimate: BatchEstimate, arc: Array, steering: Array, past: Array, period: float
) -> tuple[Array, Situation]:
  pose = np.nan_to_num(estimate.pose)
  velocity, rate = np.nan_to_num(estimate.velocity), np.nan_to_num(estimate.yaw_rate)
  moved = arc + period * task.path.errors(arc, pose, velocity, rate).arc_rate
  arc = task.path.nearest(pose[:, 0], pose[:, 1], near=moved)
  errors = task.path.errors(arc, pose, velocity, rate)
  past = remember(past, steering, errors.curvature, period)
  return arc, Situation(task.path, arc, errors, estimate.speed, steering, period, past)


def _finish(task: Task, period: float, log: list[tuple[Array, Array, BatchEstimate]]) -> Drive:
  signals = np.stack([entry[0] for entry in log])  # (T, N, 10)
  commands = np.stack([entry[1] for entry in log])
  arc, across = true_progress(task.path, signals)
  lost = np.maximum.accumulate((np.abs(across) > LOST) | ~np.isfinite(signals).all(axis=-1), axis=0)
  arrived = np.maximum.accumulate(arc >= task.distance - 0.05, axis=0)
  return Drive(
    task.path,
    period,
    signals,
    commands,
    np.stack([entry[2].pose for entry in log]),
    np.stack([entry[2].velocity for entry in log]),
    np.stack([entry[2].sideslip_angle for entry in log]),
    np.stack([entry[2].valid for entry in log]),
    across,
    arc,
    ~arrived & ~lost,
    arrived[-1] & ~(lost & ~arrived).any(axis=0),
  )


def true_progress(path: Path, signals: Array) -> tuple[Array, Array]:
  """Arc length and cross-track error of true poses, (T, N) each, followed from the start of the path."""
  poses = np.nan_to_num(signals[..., :3])
  arc = np.zeros(poses.shape[:2])
  near = np.zeros(poses.shape[1])
  for k, pose in enumerate(poses):
    near = arc[k] = path.nearest(pose[:, 0], pose[:, 1], near=near, window=0.1)
  point = path.at(arc)
  across = (poses[..., 1] - point.y) * np.cos(point.yaw) - (poses[..., 0] - point.x) * np.sin(point.yaw)
  return arc, across
