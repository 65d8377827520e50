"""A controller steers N cars along a path, from start to finish: `DrivenCars` with what is written down of them."""

import dataclasses
import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.control.interface import Body, Controller, Situation
from agents.control.speed import SpeedController, SpeedGains
from qcar_twin.envs.driven_cars import ESTIMATED, TRUE, Course, DrivenCars, Linkage, one_of
from qcar_twin.estimation.observer import Observer
from qcar_twin.paths import Path
from qcar_twin.vehicle.vehicle import QCAR

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


@dataclasses.dataclass(frozen=True)
class Scenario:
  """One run, from a path's start to its end; the episodes that an agent learns in are a `TrackingTask` (envs/task.py).

  Attributes:
    path: followed from its start.  speed: m/s, from the first instant, a number or (N,).  laps: of a closed path.
    lock: of the steering, rad.  offset, heading: start relative to the path, m and rad, numbers or (N,).
    actuation: of the steering command; None when the plant has its own servo.
  """

  path: Path
  speed: float | Array = 0.5
  laps: int = 1
  lock: float = QCAR.max_steering
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
    signals: true, (T, N, 10).  commands: of the drive in its unit, and rad, (T, N, 2).
    pose, velocity, sideslip_angle: as estimated, (T, N, 3), (T, N, 2), (T, N).
    valid: whether the estimate says it may be used, (T, N).
    cross_track: true error, m, (T, N).  arc_length: true, m, (T, N).
    under_way: before the end and not lost, (T, N).  finished: (N,).  A car whose controller's answer is no number holds
      its steering and is lost.
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

  def after(self, seconds: float) -> "Drive":
    """The same drive, of which the first so many s do not count as under way."""
    return dataclasses.replace(self, under_way=self.under_way & (self.time >= seconds)[:, None])


def start_states(scenario: Scenario, count: int) -> Array:
  """Where N cars start, (N, 7): on the path, offset and turned as the scenario says, at speed, wheels straight."""
  x, y, yaw = scenario.path.start
  offset = np.broadcast_to(np.asarray(scenario.offset, dtype=np.float64), count)
  heading = np.broadcast_to(np.asarray(scenario.heading, dtype=np.float64), count)
  zero = np.zeros(count)
  pose = x - offset * math.sin(yaw), y + offset * math.cos(yaw), yaw + heading
  return np.stack([*pose, zero + scenario.speed, zero, zero, zero], axis=-1)


def drive(
  plant: Body, theta: Array, controller: Controller, speed_gains: SpeedGains, observer: Observer, scenario: Scenario
) -> Drive:
  """Follow a path with N cars, plant parameters (N, P), until all have finished or a quarter more time has gone.

  Raises:
    ValueError: sensors of another period than the plant's, or a speed that the car of the gains does not reach.
  """
  count, period = len(theta), plant.period
  speed_gains.require(scenario.speed)
  own = getattr(getattr(observer, "suite", None), "period", period)
  if abs(own - period) > 1e-9:
    raise ValueError(f"sensors of a period of {own:g} s on a plant of {period:g} s; make the suite with the plant's")
  simulation = plant.begin(np.asarray(theta, dtype=np.float64), start_states(scenario, count))
  on_the_way = scenario.actuation and Linkage(count, period=period, **dataclasses.asdict(scenario.actuation))
  course = Course(scenario.path, scenario.speed, period)
  cars = DrivenCars(course, simulation, on_the_way, observer, partial(SpeedController, speed_gains))
  log: list[_Instant] = []
  for _ in range(int(1.25 * scenario.distance / (float(np.min(scenario.speed)) * period))):
    arc = cars.arc_length[ESTIMATED]
    errors, speed = one_of(cars.errors, ESTIMATED), cars.estimate.speed
    situation = Situation(scenario.path, arc, errors, speed, cars.steering, period, cars.past, cars.recent)
    wanted = controller.steer(situation)
    steering = np.clip(wanted, -scenario.lock, scenario.lock)
    true = cars.signals.copy(), cars.errors.cross_track[TRUE], cars.arc_length[TRUE]
    seen = cars.estimate
    cars.step(np.where(arc < scenario.distance, steering, 0.0))
    log.append(_Instant(*true, cars.commands, seen.pose, seen.velocity, seen.sideslip_angle, seen.valid, cars.mute))
    if np.all(arc >= scenario.distance):
      break
  return _finish(scenario, period, log)


class _Instant(NamedTuple):
  """A row of a `Drive`, with names as there, and whether a controller's answer was no number."""

  signals: Array
  cross_track: Array
  arc_length: Array
  commands: Array
  pose: Array
  velocity: Array
  sideslip_angle: Array
  valid: NDArray[np.bool_]
  mute: NDArray[np.bool_]


def _finish(scenario: Scenario, period: float, log: list[_Instant]) -> Drive:
  rows = {name: np.stack(column) for name, column in zip(_Instant._fields, zip(*log, strict=True), strict=True)}
  gone = rows.pop("mute") | (np.abs(rows["cross_track"]) > LOST) | ~np.isfinite(rows["signals"]).all(axis=-1)
  lost = np.maximum.accumulate(gone, axis=0)
  arrived = np.maximum.accumulate(rows["arc_length"] >= scenario.distance - 0.05, axis=0)
  finished = arrived[-1] & ~(lost & ~arrived).any(axis=0)
  return Drive(scenario.path, period, **rows, under_way=~arrived & ~lost, finished=finished)
