"""How good the federated filter is: one closed-loop drive, every estimator on the same sensor readings.

The oval of the paper's simulation: 0.5 m/s by the PI controller, LQ steering on the estimate, sensors with noise,
latency, dropouts and spikes; 20 cars side by side.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from agents.control.closed_loop import Actuation, Drive, Scenario, drive
from agents.control.interface import Controller
from agents.control.model import Model
from agents.control.speed import SpeedGains
from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.observer import Heard, SensedObserver
from qcar_twin.estimation.offline import angle_error, dead_reckoning, position_nees
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.kinematics import kinematic_sideslip_angle, sideslip_angle
from qcar_twin.paths import path_named
from qcar_twin.plant import POSE, POSITION, STEERING, VELOCITY, YAW, YAW_RATE, signal_index
from qcar_twin.sensors.base import Sensor
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors

Array = NDArray[np.float64]
WARM_UP = 200  # periods left out of every figure
SIDESLIP = 4  # column of `Oval.truth`; its first three are a pose's


@dataclasses.dataclass(frozen=True)
class Oval:
  """One drive with everything the sensors said.

  Attributes:
    result: the drive, T instants; heard[k] is what arrived at instant k + 1.
    model: that the filters use.  settings: of the filter in the loop.
  """

  result: Drive
  heard: list[Heard]
  model: Model
  settings: FilterSettings

  @property
  def truth(self) -> Array:
    """x, y, yaw, speed, sideslip, yaw rate at the instants something arrived, (T - 1, N, 6)."""
    signals = self.result.signals[1:]
    vx, vy = np.moveaxis(signals[..., VELOCITY], -1, 0)
    slip = sideslip_angle(vx, vy)
    pose = np.moveaxis(signals[..., POSE], -1, 0)
    return np.stack([*pose, np.hypot(vx, vy), slip, signals[..., YAW_RATE]], axis=-1)


def drive_oval(
  model: Model,
  plant: str,
  controller: Controller,
  count: int = 20,
  laps: int = 2,
  seed: int = 0,
  sensors: Mapping[str, Sensor] | None = None,
) -> Oval:
  """Drive the oval with `count` cars and keep all readings."""
  servo = Actuation() if plant == "bicycle" else None
  scenario = Scenario(path_named("o"), laps=laps, lock=model.vehicle.max_steering, actuation=servo)
  return drive_scenario(model, plant, controller, scenario, count, seed, sensors)


def drive_scenario(
  model: Model,
  plant: str,
  controller: Controller,
  scenario: Scenario,
  count: int,
  seed: int = 0,
  sensors: Mapping[str, Sensor] | None = None,
  settings: FilterSettings | None = None,
) -> Oval:
  """Drive what a scenario says with `count` cars on the estimate and keep all readings.

  Args:
    settings: of the filter in the loop; the plant's where not given.
  """
  body, theta = model.plant(plant)
  settings = settings or model.filter_settings(plant)
  suite = SensorSuite(dict(sensors or qcar_sensors()), count, seed)
  observer = SensedObserver(suite, model.car, settings, keep=True)
  result = drive(body, np.tile(theta, (count, 1)), controller, SpeedGains.design(model.car), observer, scenario)
  return Oval(result, observer.heard[: len(result.signals) - 1], model, settings)


@dataclasses.dataclass(frozen=True)
class Track:
  """One estimator's output at the instants of `Oval.truth`: (T - 1, N, 2), (T - 1, N); covariance xx xy yy or None."""

  position: Array
  covariance: Array | None = None
  yaw: Array | None = None
  sideslip: Array | None = None


def replay(oval: Oval, settings: FilterSettings) -> dict[str, Track]:
  """The federated filter with other settings on the same readings: the master and both local filters."""
  signals, commands = oval.result.signals, oval.result.commands
  batch = FederatedBatch(oval.model.car, settings, signals.shape[1], oldest=100)
  batch.start(signals[0, :, :3], signals[0, :, 3])
  rows: list[tuple[Array, ...]] = []
  for k, (motion, accel, fix, age) in enumerate(oval.heard):
    batch.command(commands[k])
    batch.advance(motion, accel, fix, age)
    e, cars = batch.estimate(), batch.state
    own = cars.bicycle_covariance[:, [0, 0, 1], [0, 1, 1]]
    other = cars.point_covariance[:, [0, 0, 1], [0, 1, 1]]
    rows.append(
      (e.pose[:, :2], e.covariance, e.pose[:, 2], e.sideslip_angle, cars.bicycle[:, :2], own, cars.point[:, :2], other)
    )
  fused, spread, yaw, slip, bicycle, own, point, other = (np.stack(column) for column in zip(*rows, strict=True))
  return {
    "FEKF": Track(fused, spread, yaw, slip),
    "EKF_BM alone": Track(bicycle, own, yaw, slip),
    "EKF_PM alone": Track(point, other),
  }


def central(oval: Oval) -> Track:
  """The centralised filter, car by car through the online interface."""
  settings = dataclasses.replace(oval.settings, central=True)
  signals, commands = oval.result.signals, oval.result.commands
  steps, count = len(oval.heard), signals.shape[1]
  position, yaw, slip = np.empty((steps, count, 2)), np.empty((steps, count)), np.empty((steps, count))
  covariance = np.empty((steps, count, 3))
  for i in range(count):
    online = FederatedFilter(oval.model.car, settings, watched=False)
    x, y, heading, speed = (float(v) for v in signals[0, i, :4])
    online.start(0.0, (x, y, heading), speed)
    for k, heard in enumerate(oval.heard):
      online.update(k * settings.period, "motor_voltage", float(commands[k, i, 0]))
      online.update(k * settings.period, "steering_command", float(commands[k, i, 1]))
      _tell(online, i, (k + 1) * settings.period, heard)
      e = online.estimate((k + 1) * settings.period)
      position[k, i], yaw[k, i], slip[k, i], covariance[k, i] = e[1:3], e.pose_yaw, e.sideslip_angle, e.covariance
  return Track(position, covariance, yaw, slip)


def _tell(online: FederatedFilter, i: int, time: float, heard: Heard) -> None:
  """One car's readings, lost ones left out."""
  motion, accel, fix, age = heard
  said = [("speed", motion[i, 0]), ("yaw_rate", motion[i, 1]), ("accel_x", accel[i, 0]), ("accel_y", accel[i, 1])]
  for name, value in said:
    if np.isfinite(value):
      online.update(time, name, float(value))
  if fix is not None and np.isfinite(fix[i, 0]):
    stamp = time - age * online.settings.period
    for name, value in zip(("pose_x", "pose_y", "pose_yaw", "pose_score"), fix[i], strict=True):
      online.update(stamp, name, float(value))


def lidar_alone(oval: Oval) -> Track:
  """The last fix that has arrived, held: what a controller without a filter would use."""
  last = oval.result.signals[0, :, POSE].copy()
  poses = []
  for _, _, fix, _ in oval.heard:
    if fix is not None:
      last = np.where(np.isfinite(fix[:, POSE]), fix[:, POSE], last)
    poses.append(last)
  stacked = np.stack(poses)
  return Track(stacked[..., POSITION], yaw=stacked[..., YAW])


def reckoned(oval: Oval) -> Track:
  """Encoder and gyro integrated from the true start."""
  signals, commands = oval.result.signals, oval.result.commands
  first = signals[0][:, [signal_index("velocity_x"), YAW_RATE]]
  motion = np.concatenate([first[None], np.stack([heard[0] for heard in oval.heard])])  # (T, N, 2)
  speed, yaw_rate = motion.transpose(2, 1, 0)
  track = dead_reckoning(signals[0, :, POSE], speed, yaw_rate, commands[..., STEERING].T, oval.model.car)
  track = track.transpose(1, 0, 2)[1:]
  return Track(track[..., POSITION], yaw=track[..., YAW])


def kinematic_sideslip(oval: Oval) -> dict[str, Array]:
  """Sideslip without a filter, (T - 1, N): the kinematic formula from command, from true wheel angle, as printed."""
  car = oval.model.car
  command = oval.result.commands[:-1, :, STEERING]
  wheels = oval.result.signals[1:, :, signal_index("steering_angle")]
  share = car.cornering_stiffness_front / (np.asarray(car.cornering_stiffness_front) + car.cornering_stiffness_rear)
  return {
    "kinematic, commanded angle": kinematic_sideslip_angle(command, car.cg_to_front, car.cg_to_rear),
    "kinematic, true wheel angle": kinematic_sideslip_angle(wheels, car.cg_to_front, car.cg_to_rear),
    "as printed, commanded angle": np.arctan(share) * np.tan(command),
  }


def position_rmse(oval: Oval, track: Track) -> Array:
  """Per car, m, (N,)."""
  error = track.position[WARM_UP:] - oval.truth[WARM_UP:, :, POSITION]
  return np.sqrt(np.mean(np.sum(error**2, axis=-1), axis=0))


def angle_rmse(oval: Oval, angle: Array, which: int) -> Array:
  """Per car, rad, (N,): yaw (2) or sideslip (4) of the truth."""
  return np.sqrt(np.mean(angle_error(angle, oval.truth[..., which])[WARM_UP:] ** 2, axis=0))


def mean_nees(oval: Oval, track: Track) -> Array:
  """Mean position NEES per car, (N,); 2 for a consistent filter."""
  if track.covariance is None:
    raise ValueError("this estimator states no covariance")
  error = track.position[WARM_UP:] - oval.truth[WARM_UP:, :, POSITION]
  return np.mean(position_nees(error, track.covariance[WARM_UP:]), axis=0)


def spread(values: Array, scale: float = 1.0, digits: int = 1) -> str:
  """Median and interquartile range in words."""
  low, middle, high = np.quantile(values, [0.25, 0.5, 0.75]) * scale
  return f"{middle:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
