"""How good the filter is where its model is not the car: a bent linkage, a late one, wrong noise settings.

Cars are driven along the paths once on the plain filter's estimate; every filter then takes the same readings, so that
differences are paired. A further drive has each filter in the loop.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from agents.control.closed_loop import Actuation, Drive, Scenario
from agents.control.interface import Controller
from agents.control.kpis import kpis
from agents.control.model import Model
from agents.studies.estimation_study import SIDESLIP, WARM_UP, Oval, drive_scenario
from agents.studies.filtering.consistency import block_nees
from agents.studies.tracking_study import NOMINAL, STEERING, VALIDATION
from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.models import BETA, R, V
from qcar_twin.estimation.models import YAW as BM_YAW
from qcar_twin.estimation.noise_fit import most_likely
from qcar_twin.estimation.offline import position_nees
from qcar_twin.estimation.settings import ESTIMATED, FilterSettings
from qcar_twin.kinematics import wrap_angle
from qcar_twin.paths import path_named
from qcar_twin.plant import POSITION, YAW
from qcar_twin.sensors.onboard import Imu
from qcar_twin.sensors.suite import qcar_sensors

Array = NDArray[np.float64]
PLANT, LATE = "mujoco", "late"
DELAY, LAG = 0.04, 0.05  # s, of the late linkage, besides the twin's servo
LAPS = 1
FITTED_ON = ("o", "infinity")  # paths of the drives that the noise is fitted to
FIT_SEED = 9000  # of their sensors
MOTION, TRUE_MOTION = [BM_YAW, V, BETA, R], [YAW, 3, SIDESLIP, 5]  # yaw, speed, sideslip, yaw rate in EKF_BM, `Oval`
Drives = Mapping[tuple[str, str], Oval]  # by path and linkage


@dataclasses.dataclass(frozen=True)
class Quality:
  """One filter on one drive, per car, (N,): root mean squares and the share of instants beyond a stated bound.

  Attributes:
    position, own: m, of the master and of EKF_BM alone.  yaw, sideslip: rad.  nees: mean, of the position.  beyond: -.
    numbers: what it has made of the unknown numbers at the end, by name, (N,).
    blocks: normalised squared errors by instant and block of the state, (T, N, 5).
  """

  position: Array
  own: Array
  yaw: Array
  sideslip: Array
  nees: Array
  beyond: Array
  numbers: Mapping[str, Array]
  blocks: Array


def linkage(name: str) -> Actuation:
  """Of the steering: NOMINAL, bent (gain and offset) as STEERING names it, or LATE (dead time and lag)."""
  if name == LATE:
    return Actuation(delay=DELAY, lag=LAG)
  gain, offset = STEERING[name]
  return Actuation(delay=0.0, lag=0.0, gain=gain, offset=offset)


def scenario(model: Model, path: str, how: str) -> Scenario:
  """A path to be driven with a linkage."""
  return Scenario(path_named(path), laps=LAPS, lock=model.vehicle.max_steering, actuation=linkage(how))


def drive_all(model: Model, controller: Controller, count: int, seed: int, hows: tuple[str, ...]) -> Drives:
  """Every path with every linkage on the plain filter's estimate."""
  return {
    (path, how): drive_scenario(model, PLANT, controller, scenario(model, path, how), count, seed)
    for path in VALIDATION
    for how in hows
  }


def known_of(settings: FilterSettings, how: str) -> FilterSettings:
  """Settings that know the linkage."""
  if how == LATE:
    return dataclasses.replace(settings, steering_delay=DELAY, steering_lag=settings.steering_lag + LAG)
  gain, offset = STEERING[how]
  return dataclasses.replace(settings, steering_gain=gain, steering_offset=float(offset))


def fitted(model: Model, settings: FilterSettings, controller: Controller, count: int) -> FilterSettings:
  """The process noise under which the fixes of nominal drives of their own are most likely."""
  drives = [
    drive_scenario(model, PLANT, controller, scenario(model, path, NOMINAL), count, FIT_SEED + i)
    for i, path in enumerate(FITTED_ON)
  ]

  def evidence(trial: FilterSettings) -> tuple[float, float]:
    bicycle, point = filtered(drives, trial)[0].evidence.sum(axis=0)
    return float(bicycle), float(point)

  return most_likely(evidence, settings, rounds=1)


def filtered(ovals: Sequence[Oval], settings: FilterSettings) -> tuple[FederatedBatch, list[tuple[Array, ...]]]:
  """One filter on the readings of all cars of several drives side by side: it, and its estimates by instant.

  A drive that has ended has no more samples; all have the same sensors, so that fixes come at the same instants.
  """
  counts = [oval.result.signals.shape[1] for oval in ovals]
  first = np.concatenate([oval.result.signals[0, :, :4] for oval in ovals])
  batch = FederatedBatch(ovals[0].model.car, settings, sum(counts), oldest=100)
  batch.start(first[:, :3], first[:, 3])
  rows: list[tuple[Array, ...]] = []
  for k in range(max(len(oval.heard) for oval in ovals)):
    beside = [_at(oval, k, count) for oval, count in zip(ovals, counts, strict=True)]
    commands, motion, accel, fix = (np.concatenate(part) for part in zip(*(b[:4] for b in beside), strict=True))
    batch.command(commands)
    arrived = np.isfinite(fix).any()
    batch.advance(motion, accel, fix if arrived else None, max(b[4] for b in beside) if arrived else 0)
    e = batch.estimate()
    own = batch.state.bicycle, np.diagonal(batch.state.bicycle_covariance, axis1=1, axis2=2)
    rows.append((e.pose, e.covariance, e.bounds, own[0][:, POSITION], own[0][:, MOTION], own[1][:, MOTION]))
  return batch, rows


def _at(oval: Oval, k: int, count: int) -> tuple[Array, Array, Array, Array, int]:
  """Commands, motion, accelerations, fix and its age at an instant of a drive; NaN for none."""
  none = np.full((count, 4), np.nan)
  if k >= len(oval.heard):
    return none[:, :2], none[:, :2], none[:, :2], none, 0
  motion, accel, fix, age = oval.heard[k]
  return oval.result.commands[k], motion, accel, none if fix is None else fix, age


def quality(ovals: Sequence[Oval], settings: FilterSettings) -> list[Quality]:
  """The filter with these settings on the readings of drives, each by itself."""
  batch, rows = filtered(ovals, settings)
  columns, done, at = [np.stack(column) for column in zip(*rows, strict=True)], [], 0
  for oval in ovals:
    cars = slice(at, at := at + oval.result.signals.shape[1])
    numbers = {name: getattr(settings, name) + batch.state.bicycle[cars, row] for name, row in settings.rows.items()}
    done.append(_judged(oval, [column[WARM_UP : len(oval.heard), cars] for column in columns], numbers))
  return done


def _judged(oval: Oval, columns: list[Array], numbers: Mapping[str, Array]) -> Quality:
  pose, covariance, bounds, own, motion, variances = columns
  truth = oval.truth[WARM_UP:]
  off, own = pose[..., POSITION] - truth[..., POSITION], own - truth[..., POSITION]
  wrong_by = motion - truth[..., TRUE_MOTION]
  wrong_by[..., ::2] = wrap_angle(wrong_by[..., ::2])  # yaw and sideslip
  turned, slid = wrong_by[..., 0], wrong_by[..., 2]
  consistency = position_nees(off, covariance)
  wrong = np.stack([np.hypot(off[..., 0], off[..., 1]), np.abs(turned)], axis=-1) > bounds
  mean = lambda a: np.sqrt(np.mean(a**2, axis=0))
  place = lambda a: np.sqrt(np.mean(np.sum(a**2, axis=-1), axis=0))
  return Quality(
    place(off),
    place(own),
    mean(turned),
    mean(slid),
    np.mean(consistency, axis=0),
    wrong.any(axis=-1).mean(axis=0),
    numbers,
    block_nees(consistency, wrong_by, variances),
  )


def tracked(
  model: Model, controller: Controller, settings: FilterSettings, path: str, how: str, count: int, seed: int
) -> Array:
  """True root mean square of the cross-track error, m, (N,), with a filter in the loop and a linkage."""
  done: Drive = drive_scenario(
    model, PLANT, controller, scenario(model, path, how), count, seed, settings=settings
  ).result
  return kpis(done).rmse


def offset_imu(
  model: Model,
  controller: Controller,
  what: Scenario,
  count: int,
  seed: int,
  accelerometer: float | None = None,
  gyro: float | None = None,
) -> Oval:
  """A drive whose IMU is switched on with other biases: standard deviations, m/s^2 and rad/s."""
  imu = Imu()
  for name, bias in (("accel", accelerometer), ("gyro", gyro)):
    if bias is not None:
      imu = dataclasses.replace(imu, **{name: dataclasses.replace(getattr(imu, name), bias=bias)})
  return drive_scenario(model, PLANT, controller, what, count, seed, sensors=qcar_sensors() | {"imu": imu})


def learning(settings: FilterSettings) -> FilterSettings:
  """Settings that estimate what is worth it."""
  return settings.estimating(*ESTIMATED)
