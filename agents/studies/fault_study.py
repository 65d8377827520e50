"""What the federated filter makes of faulty sensors: five classes of faults, paths and seeds, the same drives for all.

The car is steered on the estimate of a filter with sound sensors; what its sensors would have said with a fault is
made afterwards from the same true signals, so that a fault can neither hide nor add to its effect by steering the car
elsewhere, and every faulty run has a sound one with the same noise. The speed swings, or a frozen encoder
would be right.
"""

import dataclasses
import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from agents.control.closed_loop import Scenario, start_states
from agents.control.interface import Controller, Situation
from agents.control.model import Model
from agents.control.speed import SpeedController, SpeedGains
from qcar_twin.envs.driven_cars import ESTIMATED, Course, DrivenCars, one_of
from qcar_twin.estimation.observer import SensedObserver
from qcar_twin.estimation.offline import angle_error, position_nees
from qcar_twin.paths import path_named
from qcar_twin.plant import POSE, POSITION, YAW
from qcar_twin.sensors.faults import Fault, Kind
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
PATHS = ("o", "infinity", "c")
BEGIN, END, SECONDS = 6.0, 11.0, 20.0  # s: of the fault, of the drive
SPEED, SWING, SWING_PERIOD = 0.5, 0.2, 6.0  # m/s, m/s, s
WARM_UP = 2.0  # s, left out of every figure
FIX = ("pose_x", "pose_y", "pose_yaw", "pose_score")


@dataclasses.dataclass(frozen=True)
class FaultClass:
  """A class of faults.

  Attributes:
    about: in words.
    variants: what is wrong at once; the runs are shared out among them.
    end: s, from when on a recovery is counted.
  """

  about: str
  variants: tuple[tuple[Fault, ...], ...]
  end: float = END


def _during(channel: str, kind: Kind, size: float = 0.0, chance: float = 0.0) -> Fault:
  return Fault(channel, kind, BEGIN, END, size, chance)


FAULTS = {
  "none": FaultClass("sound sensors", ((),)),
  "lidar lost": FaultClass("no fix for 5 s", (tuple(_during(name, "lost") for name in FIX),)),
  "gyro bias jump": FaultClass(
    "+0.1 or -0.1 rad/s from then on, for good",
    tuple((Fault("yaw_rate", "offset", BEGIN, size=size),) for size in (0.1, -0.1)),
    BEGIN,
  ),
  "encoder stuck": FaultClass(
    "at zero, or at its last sample, for 5 s", ((_during("motor_speed", "stuck"),), (_during("motor_speed", "frozen"),))
  ),
  "latency doubled": FaultClass(
    "fixes 100 ms late instead of 50 for 5 s, stamped rightly",
    ((_during("pose_x", "late", 0.05),),),
  ),
  "latency doubled unsaid": FaultClass(
    "the same, stamped as if 50 ms late",
    ((_during("pose_x", "late_unsaid", 0.05),),),
  ),
  "spikes": FaultClass(
    "30 % of the fixes off by 0.5 m, 5 % of the gyro's samples by 1 rad/s, of the encoder's by 0.5 m/s, for 5 s",
    (
      (
        _during("pose_x", "spikes", 0.5, 0.3),
        _during("yaw_rate", "spikes", 1.0, 0.05),
        _during("motor_speed", "spikes", 160.0, 0.05),
      ),
    ),
  ),
}


@dataclasses.dataclass(frozen=True)
class Recorded:
  """N cars driven along a path: true signals (T + 1, N, 10) and commands (T, N, 2); seed of their sensors."""

  path: str
  signals: Array
  commands: Array
  seed: int


@dataclasses.dataclass(frozen=True)
class Run:
  """N runs of an estimator: errors, what it states, whether it says it is valid; (T, N).

  Attributes:
    position: estimated minus true, m, (T, N, 2).  yaw: estimated minus true, rad.
    covariance: of the position, xx xy yy, m^2, (T, N, 3).
    bounds: of the errors of position, m, and yaw, rad, (T, N, 2).
  """

  position: Array
  yaw: Array
  covariance: Array
  bounds: Array
  valid: Mask

  @property
  def error(self) -> Array:
    """Of the position, m."""
    return np.hypot(*np.moveaxis(self.position, -1, 0))

  @property
  def beyond(self) -> Mask:
    """Which errors of position and of yaw are beyond their bounds, (T, N, 2)."""
    return np.stack([self.error, np.abs(self.yaw)], axis=-1) > self.bounds

  @property
  def nees(self) -> Array:
    """Of the position."""
    return position_nees(self.position, self.covariance)


def target_speed(time: float) -> float:
  """m/s."""
  return SPEED + SWING * math.sin(2.0 * math.pi * time / SWING_PERIOD)


def record(model: Model, plant: str, controller: Controller, path: str, count: int, seed: int) -> Recorded:
  """Drive a path with `count` cars on the estimates of sound sensors."""
  body, theta = model.plant(plant)
  scenario = Scenario(path_named(path), speed=SPEED, lock=model.vehicle.max_steering)
  suite = SensorSuite(qcar_sensors(), count, seed)
  observer = SensedObserver(suite, model.car, model.filter_settings(plant))
  simulation = body.begin(np.tile(theta, (count, 1)), start_states(scenario, count))
  course = Course(scenario.path, SPEED, body.period)
  cars = DrivenCars(course, simulation, None, observer, partial(SpeedController, SpeedGains.design(model.car)))
  signals, commands = [cars.signals.copy()], []
  for k in range(round(SECONDS / body.period)):
    cars.course = dataclasses.replace(course, speed=target_speed(k * body.period))
    errors = one_of(cars.errors, ESTIMATED)
    seen = Situation(
      scenario.path,
      cars.arc_length[ESTIMATED],
      errors,
      cars.estimate.speed,
      cars.steering,
      body.period,
      cars.past,
      cars.recent,
    )
    cars.step(np.clip(controller.steer(seen), -scenario.lock, scenario.lock))
    commands.append(cars.commands.copy())
    signals.append(cars.signals.copy())
  return Recorded(path, np.stack(signals), np.stack(commands), seed)


def estimate(model: Model, plant: str, drive: Recorded, faults: tuple[Fault, ...], watched: bool = True) -> Run:
  """The filter on a drive whose sensors have these faults; its first row is the instant after the start."""
  suite = SensorSuite(qcar_sensors(), drive.signals.shape[1], drive.seed, faults=faults)
  observer = SensedObserver(suite, model.car, model.filter_settings(plant), watched=watched)
  observer.begin(drive.signals[0])
  rows = []
  for commands, signals in zip(drive.commands, drive.signals[1:], strict=True):
    observer.command(commands)
    e, truth = observer.observe(signals), signals[:, POSE]
    turned = angle_error(e.pose[:, YAW], truth[:, YAW])
    rows.append((e.pose[:, POSITION] - truth[:, POSITION], turned, e.covariance, e.bounds, e.valid))
  return Run(*(np.stack(column) for column in zip(*rows, strict=True)))
