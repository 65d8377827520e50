"""The watches of N cars at work: what they take out of the measurements, and what they open in the covariance.

Three things may be wrong where model, sensor and clock disagree, and each has witnesses of its own. A gyro is judged by
the turns between raw fixes, an encoder by their distances, its own past and the accelerometer, stamps by their beat.
The filter's gate is the model's view of a sensor: a refusal that persists is doubt about the model, and the sensor is
used with the covariance opened, until its own witness speaks against it.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.models import BETA, YAW, R, V, cg_acceleration, lateral_acceleration
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.estimation.state import PLACE, FilterState
from qcar_twin.estimation.unknowns import Unknowns, forget

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
SPEED, YAW_RATE = 0, 1  # columns of the measured motion
POSE, YAW_OF_FIX = slice(0, 3), 2  # columns of a fix
VOLTAGE = 0  # column of the commands
ACCEL_Y = 1  # column of the acceleration


class Watching:
  """Watches of N cars, whose memory is in their `FilterState`.

  Args:
    car: the single track, plain floats.
    settings: of the filter.
    unknowns: what is not known of the cars.
  """

  def __init__(self, car: SingleTrackCar, settings: FilterSettings, unknowns: Unknowns):
    self._car, self._settings, self._unknowns = car, settings, unknowns

  # -- the model ---------------------------------------------------------------------------------

  def prediction(self, state: FilterState, before: Array, transition: Array) -> Array:
    """Process noise of EKF_BM, (N, n, n), as far as each car's single track may be believed.

    What it predicts for sliding cars from the states (N, n) before is put right in `state` and in `transition`.
    """
    settings, lever = self._settings, (self._settings.imu_x, self._settings.imu_y)
    state.models = tuple(watch.copy() for watch in state.models)
    noise = np.tile(settings.bicycle_noise, (len(state.models), 1, 1))
    for i, watch in enumerate(state.models):
      row, angle, felt = before[i].tolist(), state.wheel_angle.item(i), (math.nan, math.nan)
      expected, _ = lateral_acceleration(tuple(row[:6]), angle, self._car, math)
      if state.accel_age.item(i) <= settings.accel_timeout:
        felt = cg_acceleration(tuple(state.accel[i].tolist()), row[R], lever)
      watch.feel(felt[ACCEL_Y], expected, settings.period)
      watch.weigh(row[V], angle, self._car, settings.period)
      beyond = watch.sideslip_noise(row[V], self._car, settings.period, settings.lidar_interval)
      noise[i, BETA, BETA] = max(noise.item(i, BETA, BETA), beyond)
      if watch.sliding:
        noise[i, V, V] = max(noise.item(i, V, V), beyond * row[V] ** 2)
        slide(state.bicycle[i], transition[i], row, felt, settings.period)
    return noise

  # -- encoder and gyro --------------------------------------------------------------------------

  def motion(self, state: FilterState, raw: Array, motion: Array) -> None:
    """Take out of `motion`, (N, 2), what is not believed; open the state of cars whose model is not.

    Args:
      raw: speeds as the encoders say them, m/s, (N,).
    """
    self._encoders(state, raw, motion)
    self._gyros(state, motion)

  def _encoders(self, state: FilterState, raw: Array, motion: Array) -> None:
    """Open the speed of cars that have felt what their encoder says."""
    settings, limit = self._settings, self._settings.limits[0]
    state.watches = tuple(watch.copy() for watch in state.watches)
    forward = np.where(state.accel_age <= settings.accel_timeout, state.accel[:, 0], np.nan)
    reaches = np.sqrt(limit * (self._unknowns.measured(state, V)[1] + settings.speed_std**2))
    opened, gain = np.zeros(len(raw)), float(self._car.drive_gain) * float(self._car.rolling_radius)
    for i, watch in enumerate(state.watches):
      watch.coast(float(forward[i]), settings.period)
      speed, reach = float(motion[i, SPEED]), float(reaches[i])
      if not math.isfinite(speed):
        continue
      watch.hear(float(raw[i]), gain * state.commands.item(i, VOLTAGE), settings.period)
      watch.travel(speed, settings.period)
      if state.models[i].sliding:  # wheels past their knee spin or lock: the accelerometer leads the speed
        watch.excuse(state.bicycle.item(i, V))
        motion[i, SPEED] = np.nan
        continue
      innovation = speed - float(state.bicycle[i, V])
      fits = abs(innovation) <= reach
      if not fits and state.models[i].gives:  # wheels may slip: it is left out, and nobody accused
        continue
      if not (fits or watch.suspended) and watch.supported(speed, reach):
        opened[i], fits = innovation**2, True
      watch.judge(speed, innovation, reach, fits)
    _open(state, V, opened)
    motion[[not watch.believed for watch in state.watches], SPEED] = np.nan

  def _gyros(self, state: FilterState, motion: Array) -> None:
    """Open the yaw rate of cars whose gyro refutes the single track, and add up what the gyros say."""
    period = self._settings.period
    state.odometers = tuple(odometer.copy() for odometer in state.odometers)
    spread = self._unknowns.measured(state, R)[1] + self._settings.yaw_rate_std**2
    reaches = np.sqrt(self._settings.limits[0] * spread)
    opened = np.zeros(len(motion))
    for i, (odometer, watch) in enumerate(zip(state.odometers, state.models, strict=True)):
      odometer.travel(motion.item(i, YAW_RATE), period, self._settings.yaw_rate_std)
      motion[i, YAW_RATE] -= odometer.bias
      if odometer.doubted:
        motion[i, YAW_RATE] = np.nan
      innovation = motion.item(i, YAW_RATE) - state.bicycle.item(i, R)
      if math.isfinite(innovation):
        watch.judge(innovation, abs(innovation) <= reaches.item(i), period)
        opened[i] = innovation**2 * watch.refuted
    _open(state, R, opened)

  # -- fixes -------------------------------------------------------------------------------------

  def fixes(self, state: FilterState, fix: Array, offsets: Array, time: float, noise: Array) -> tuple[Array, Array]:
    """Fixes, (N, 4), without those that are off the beat, and when they were measured after the slot, s, (N,).

    They are witnesses of encoders and gyros, whatever the filter thinks of them.

    Args:
      noise: variances of x, y and yaw, m^2 and rad^2, (N, 3).
    """
    state.clocks = tuple(clock.copy() for clock in state.clocks)
    fix, offsets = fix.copy(), offsets.copy()
    turned, placed = np.zeros((2, len(fix))), np.isfinite(fix[:, PLACE]).all(axis=1)
    holes, state.hole = state.hole, np.where(placed, 0.0, state.hole)
    for i in np.flatnonzero(placed):
      if not state.clocks[i].hear(time + float(offsets[i]), holes.item(i)):
        fix[i] = np.nan
        state.refuse("pose", "off the beat", np.arange(len(fix)) == i)
        continue
      offsets[i] -= state.clocks[i].delay
      (x, y, yaw, _), odometer = fix[i].tolist(), state.odometers[i]
      place, angle = (math.sqrt(noise.item(i, k) / self._settings.lidar_factor) for k in (0, YAW_OF_FIX))
      if not state.models[i].sliding:
        state.watches[i].compare(time + float(offsets[i]), x, y, place, odometer.turned)
      if math.isfinite(yaw):
        wrong = odometer.witness(time, yaw - float(offsets[i]) * odometer.rate, angle)
        turned[:, i] = wrong**2, (wrong / self._settings.lidar_interval) ** 2
    _open(state, YAW, turned[0])
    _open(state, R, turned[1])
    return fix, offsets

  def accepted(self, state: FilterState, fix: Array, noise: Array, offsets: Array, time: float, which: Mask) -> None:
    """Let accepted fixes judge gyros' biases; what was wrong for a while is known less well."""
    settings, unseen = self._settings, state.unseen.copy()
    widened, detected = np.zeros((2, len(fix))), np.zeros(len(fix), dtype=bool)
    for i in np.flatnonzero(which & np.isfinite(fix[:, POSE]).all(axis=1)):
      odometer, rate = state.odometers[i], state.bicycle.item(i, R)
      yaw, std = fix.item(i, YAW_OF_FIX) - float(offsets[i]) * rate, math.sqrt(noise.item(i, YAW_OF_FIX))
      estimate = odometer.compare(time, yaw, std / math.sqrt(settings.lidar_factor), rate, settings.lidar_correlation)
      unseen[i], state.models[i].risked = odometer.unseen, 0.0
      if estimate is not None:
        detected[i] = True
        widened[:, i] = (0.5 * estimate.span * estimate.bias) ** 2, estimate.bias**2
    state.unseen = unseen
    if "yaw_rate_bias" in settings.rows:  # what EKF_BM had made of it is in the finding
      forget(state, settings.rows["yaw_rate_bias"], settings.yaw_rate_bias_std, detected)
    _open(state, YAW, widened[0])
    _open(state, R, widened[1])


def slide(state: Array, transition: Array, before: Sequence[float], felt: tuple, period: float) -> None:
  """Predict a sliding car by its acceleration at the centre of gravity, m/s^2, in `state` and the Jacobian's rows.

  v' = a_x cos beta + a_y sin beta, beta' = (a_y cos beta - a_x sin beta) / v - r. Tyres that have given way say nothing
  of the yaw rate either, which the gyro tells: it is held. A car that has spun past 90 degrees goes in reverse.
  """
  v, beta, rate = before[V], before[BETA], before[R]
  cos, sin = math.cos(beta), math.sin(beta)
  along, across = felt[0] * cos + felt[1] * sin, felt[1] * cos - felt[0] * sin
  state[[V, BETA, R]] = v + period * along, beta + period * (across / v - rate), rate
  transition[[V, BETA, R], :] = 0.0
  transition[V, [V, BETA]] = 1.0, period * across
  transition[BETA, [V, BETA, R]] = -period * across / v**2, 1.0 - period * along / v, -period
  transition[R, R] = 1.0
  if math.cos(state[BETA]) < 0.0:
    state[[V, BETA]] = -state[V], state[BETA] - math.copysign(math.pi, state[BETA])
    transition[V, :] *= -1.0


def _open(state: FilterState, row: int, variance: Array) -> None:
  """Add variances, (N,), to a component of EKF_BM."""
  if variance.any():
    state.bicycle_covariance = state.bicycle_covariance.copy()
    state.bicycle_covariance[:, row, row] += variance
