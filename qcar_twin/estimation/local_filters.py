"""The two local filters of N cars: one control period at a time, no clock.

EKF_BM is the single track (position, speed, yaw, sideslip, yaw rate) with lidar, encoder and gyro; EKF_PM is
the point mass driven by the accelerometer, with the lidar's position. A missing sample is NaN.
"""

import dataclasses
import math
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.engines import Engine, engine_of
from qcar_twin.estimation.kalman import Corrected
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
from qcar_twin.estimation.settings import MOTION_STATES, FilterSettings
from qcar_twin.estimation.state import PLACE, POINT_START_STD, FilterState, Slot, choose
from qcar_twin.estimation.unknowns import Unknowns
from qcar_twin.estimation.watches.silence import unheard_noise
from qcar_twin.estimation.watches.watching import POSE, SPEED, Watching
from qcar_twin.kinematics import wrap_angle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
LOST_STD = 0.5  # m and rad, added to a pose that steady fixes contradict
STEADY = 0.2  # m: refused fixes that lie this close to each other, the car's own motion allowed for, are no spikes
STRAYING = 1.5  # times the distance driven since the last one is allowed besides
MISTAKEN = 1e-6  # probability of taking strays for a new place, per fix
REMEMBERED = 20.0  # fixes by which it is known how often the lidar strays
MOTION_ROWS, POSE_ROWS, PLACE_ROWS = (V, R), (X, Y, YAW), (X, Y)  # of a state, what is measured of it
VOLTAGE, STEERING = 0, 1  # columns of the commands
ACCEL_Y = 1  # column of the acceleration
SCORE = 3  # column of a fix
BICYCLE, POINT = 0, 1  # columns of NIS and evidence


class LocalFilters:
  """EKF_BM and EKF_PM of N cars.

  Args:
    car: the identified single-track model, one for all cars.
    settings: noise, gates, limits.
    count: N.
    lib: `numpy`; for one car also `math`, whose plain floats step the models in a tenth of the time.
    engine: whose algebra predicts and corrects.

  Attributes:
    nis: of the last lidar fix in EKF_BM and in EKF_PM, (N, 2).
  """

  def __init__(
    self, car: SingleTrackCar, settings: FilterSettings, count: int, lib: ModuleType = np, engine: Engine = "batched"
  ):
    numbers = {f.name: float(np.asarray(getattr(car, f.name))) for f in dataclasses.fields(SingleTrackCar)}
    self.settings, self.car, self._lib = settings, SingleTrackCar(**numbers), lib
    self.nis = np.full((count, 2), np.nan)
    self._identity = np.tile(np.eye(MOTION_STATES + len(settings.rows)), (count, 1, 1))
    self._point_transition = np.eye(4)
    self._point_transition[[X, Y], [2, 3]] = settings.period
    lag = settings.steering_lag
    self._servo = 1.0 - math.exp(-settings.period / lag) if lag > 0.0 else 1.0
    self._noises = settings.speed_std**2, settings.yaw_rate_std**2
    self._accel_bias = np.array([settings.accel_x_bias, settings.accel_y_bias])
    self._limits = np.array([0.0, *settings.limits])  # of the NIS, by the number of measured components
    self._assumed_score = settings.score * settings.score_full / 100.0
    self._engine, self._algebra = engine, engine_of(engine, count)
    self._unknowns = Unknowns(self.car, settings)
    self._watching = Watching(self.car, settings, self._unknowns)

  def __getstate__(self) -> dict[str, Any]:
    """For a copy or another process: the library by its name."""
    return {**vars(self), "_lib": self._lib.__name__, "_algebra": len(self.nis)}

  def __setstate__(self, state: dict[str, Any]) -> None:
    algebra = engine_of(state["_engine"], state["_algebra"])
    vars(self).update(state, _lib={"math": math, "numpy": np}[state["_lib"]], _algebra=algebra)

  def step(self, start: FilterState, before: Slot, now: Slot, time: float) -> FilterState:
    """One period: the inputs of the slot before, the measurements of the slot at its end, `time` s."""
    state = start.copy()
    self._take_inputs(state, before)
    self._predict(state)
    state.silent = np.where(now.heard, 0.0, start.silent + self.settings.period)
    state.hole = np.maximum(start.hole, state.silent)
    self._correct_motion(state, now.motion)
    if self.settings.central:
      self._correct_acceleration(state, now.accel)
    if now.fix is not None:
      self._correct_pose(state, now.fix, now.offset, time)
    return state

  def point_on(self, state: FilterState) -> Mask:
    """Cars whose EKF_PM has an accelerometer, (N,)."""
    return np.asarray((state.accel_age <= self.settings.accel_timeout) & (not self.settings.central))

  # -- prediction --------------------------------------------------------------------------------

  def _take_inputs(self, state: FilterState, slot: Slot) -> None:
    """Inputs that act from this slot until the next."""
    state.commands = np.where(np.isfinite(slot.commands), slot.commands, state.commands)
    heard = np.asarray(np.isfinite(slot.accel).all(axis=1))
    state.accel = np.where(heard[:, None], slot.accel - self._accel_bias, state.accel)
    state.accel_age = np.where(heard, 0.0, state.accel_age)

  def _predict(self, state: FilterState) -> None:
    settings, h = self.settings, self.settings.period
    acting = self._acting(state)
    state.servo_angle = state.servo_angle + self._servo * (acting[:, STEERING] - state.servo_angle)
    state.wheel_angle = self._unknowns.wheel_angle(state)
    volts = self._unknowns.of(state, "drive_scale") * acting[:, VOLTAGE]
    state.accel_age = state.accel_age + h
    state.age = state.age + h
    state.driven = state.driven + np.abs(state.bicycle[:, V]) * h
    bicycle, point, accel = (self._columns(a) for a in (state.bicycle, state.point, state.accel))
    voltage, angle = self._columns(np.stack([volts, state.wheel_angle], axis=-1))
    at_centre = cg_acceleration(accel, bicycle[R], (settings.imu_x, settings.imu_y))
    ahead = point_step(point, at_centre, bicycle[YAW] + 0.5 * h * bicycle[R], h, self._lib)
    following, slopes = bicycle_step(bicycle[:MOTION_STATES], voltage, angle, self.car, h, self._lib)
    transition = self._identity.copy()
    fill_jacobian(transition, slopes, h)
    if settings.rows:
      self._unknowns.fill(transition, state, acting[:, VOLTAGE], following[V])
    before, state.bicycle = (
      state.bicycle,
      np.array((*following, *bicycle[MOTION_STATES:])).T.reshape(state.bicycle.shape),
    )
    noise = settings.bicycle_noise
    if state.watches:
      noise = self._watching.prediction(state, before, transition)
    unheard = unheard_noise(state.silent, before[:, V], self.car, settings)
    noise = noise if unheard is None else noise + unheard
    state.bicycle_covariance = self._algebra.predict(state.bicycle_covariance, transition, noise)
    state.point_covariance = self._algebra.predict(state.point_covariance, self._point_transition, settings.point_noise)
    state.point = np.array(ahead).T.reshape(state.point.shape)
    off = ~self.point_on(state)
    if off.any():
      self._restart_point(state, off)

  def _acting(self, state: FilterState) -> Array:
    """Commands that act in this period, (N, 2): those that were given a dead time ago."""
    if not state.waiting.shape[1]:
      return state.commands
    line = np.concatenate([state.waiting, state.commands[:, None]], axis=1)
    state.waiting, newest = line[:, 1:], line.shape[1] - 1
    return np.stack([line[:, newest - delay, i] for i, delay in enumerate(self.settings.delays)], axis=-1)

  def _columns(self, array: Array) -> tuple:
    """Components of (N, k): k floats for `math`, k arrays (N,) for `numpy`."""
    return tuple(array[0].tolist()) if self._lib is math else tuple(array.T)

  def _restart_point(self, state: FilterState, which: Mask) -> None:
    """Put EKF_PM where EKF_BM is: it has lost its accelerometer or its way."""
    v, course = state.bicycle[:, V], state.bicycle[:, YAW] + state.bicycle[:, BETA]
    fresh = np.stack([*state.bicycle[:, PLACE].T, v * np.cos(course), v * np.sin(course)], axis=-1)
    covariance = np.tile(np.diag(np.square(POINT_START_STD)), (len(v), 1, 1))
    covariance[:, PLACE, PLACE] = state.bicycle_covariance[:, PLACE, PLACE]
    state.point = choose(which, fresh, state.point)
    state.point_covariance = choose(which, covariance, state.point_covariance)

  # -- encoder, gyro, accelerometer --------------------------------------------------------------

  def _correct_motion(self, state: FilterState, measured: Array) -> None:
    """Encoder, then gyro; both gates look at the prediction, as in the joint update."""
    settings, limit = self.settings, self.settings.limits[0]
    motion = self._unknowns.as_said(state, measured)
    if settings.front_drive_share:
      motion[:, SPEED] /= 1.0 + settings.front_drive_share * (1.0 / np.cos(state.wheel_angle) - 1.0)
    if state.watches:
      self._watching.motion(state, measured[:, SPEED], motion)
    used = []
    for row, noise, name, value in zip(MOTION_ROWS, self._noises, ("speed", "yaw_rate"), motion.T, strict=True):
      innovation = value - state.bicycle[:, row]
      fits = innovation**2 <= limit * (self._unknowns.measured(state, row)[1] + noise)
      if not fits.all():
        state.refuse(name, "gate", np.isfinite(value) & ~fits)
      used.append(fits)
    for row, noise, fits, value in zip(MOTION_ROWS, self._noises, used, motion.T, strict=True):
      before = state.bicycle, state.bicycle_covariance
      column, spread = self._unknowns.measured(state, row)
      innovation = np.where(fits, value - state.bicycle[:, row], 0.0)
      state.bicycle, state.bicycle_covariance = self._algebra.absorb(
        state.bicycle, state.bicycle_covariance, column, spread + noise, innovation, fits
      )
      self._unknowns.consider(state, before, row)

  def _correct_acceleration(self, state: FilterState, accel: Array) -> None:
    """The centralised filter's use of the accelerometer: a_y = (F_front + F_rear) / m."""
    columns, settings = tuple(state.bicycle.T), self.settings
    specific = 0.0, accel[:, ACCEL_Y] - settings.accel_y_bias
    _, measured = cg_acceleration(specific, columns[R], (0.0, settings.imu_y))
    expected, by = lateral_acceleration(columns[:MOTION_STATES], state.wheel_angle, self.car, np)
    slope = np.zeros_like(state.bicycle)
    slope[:, [V, BETA, R]] = np.stack(np.broadcast_arrays(*by), axis=-1)
    column = (state.bicycle_covariance @ slope[:, :, None])[:, :, 0]
    spread = (slope * column).sum(axis=1) + settings.accel_std**2
    fits = (measured - expected) ** 2 <= settings.limits[0] * spread
    innovation = np.where(fits, measured - expected, 0.0)
    state.bicycle, state.bicycle_covariance = self._algebra.absorb(
      state.bicycle, state.bicycle_covariance, column, spread, innovation, fits
    )

  # -- lidar -------------------------------------------------------------------------------------

  def _correct_pose(self, state: FilterState, fix: Array, offset: float, time: float) -> None:
    """A lidar fix into both filters; `offset` is its stamp after the slot, s."""
    scored = np.isfinite(fix[:, SCORE])
    position, yaw = self.settings.pose_noise(np.where(scored, fix[:, SCORE], self._assumed_score))
    noise = np.stack([position, position, yaw], axis=-1)
    offsets = np.full(len(fix), offset)
    if state.watches:
      fix, offsets = self._watching.fixes(state, fix, offsets, time, noise)
    # without lidar EKF_PM soon believes anything, so a fix must pass the gate of EKF_BM first
    accepted = self._fix_bicycle(state, fix[:, POSE], noise / self.settings.sharing[BICYCLE], offsets)
    self._fix_point(state, fix[:, PLACE], noise[:, PLACE] / self.settings.sharing[POINT], offsets, accepted)
    if state.watches:
      self._watching.accepted(state, fix, noise, offsets, time, accepted)

  def _fix_bicycle(self, state: FilterState, pose: Array, noise: Array, offset: Array) -> Mask:
    """Take poses, (N, 3), where they fit or the car is lost without them; which ones."""
    there = np.isfinite(pose)
    values = pose.copy()
    if offset.any():
      v, course = state.bicycle[:, V], state.bicycle[:, YAW] + state.bicycle[:, BETA]
      ahead = v * np.cos(course), v * np.sin(course), state.bicycle[:, R]
      values -= offset[:, None] * np.stack(ahead, axis=-1)
    turned = np.where(there[:, 2], values[:, 2] - state.bicycle[:, YAW], 0.0)
    values[:, 2] = state.bicycle[:, YAW] + wrap_angle(turned)
    trial = self._algebra.correct_together(state.bicycle, state.bicycle_covariance, POSE_ROWS, values, noise, there)
    fits, some = self._judge(state, trial, there, BICYCLE), np.asarray(there.any(axis=1))
    wrong, lost = some & ~fits, np.zeros(len(pose), dtype=bool)
    accepted = some & fits
    if wrong.any():
      state.refuse("pose", "gate", wrong)
      lost = self._refuse(state, wrong, np.where(there[:, PLACE], pose[:, PLACE], state.bicycle[:, PLACE]))
      if lost.any():
        widened = state.bicycle_covariance + np.diag(
          np.isin(np.arange(state.bicycle.shape[1]), POSE_ROWS) * LOST_STD**2
        )
        again = self._algebra.correct_together(state.bicycle, widened, POSE_ROWS, values, noise, there)
        trial = Corrected(*(choose(lost, a, b) for a, b in zip(again, trial, strict=True)))
        accepted |= lost
    before = state.bicycle, state.bicycle_covariance
    state.bicycle = choose(accepted, trial.state, state.bicycle)
    state.bicycle_covariance = choose(accepted, trial.covariance, state.bicycle_covariance)
    self._unknowns.consider(state, before)
    state.age = np.where(accepted, 0.0, state.age)
    self._reckon(state, some, accepted, lost)
    return accepted

  def _refuse(self, state: FilterState, wrong: Mask, place: Array) -> Mask:
    """Count votes of refused fixes for the place where they are; the cars that are lost by now.

    A refused fix elsewhere, or an accepted one, takes a vote back. Votes decide where strays as frequent as this
    lidar's, all at one place, would hardly make as many: odds^votes < MISTAKEN, as in a random walk's ruin.
    """
    close = (state.steady > 0) & (np.hypot(*(place - state.last).T) < STEADY + STRAYING * state.driven)
    votes = close | (state.steady == 0)
    state.strays = state.strays + (wrong & ~votes)
    state.steady = state.steady + np.where(votes, 1, -1) * wrong
    state.refused = state.refused + wrong
    state.last = choose(wrong & votes, place, state.last)
    state.driven = np.where(wrong & votes, 0.0, state.driven)
    odds = (state.strays + 1.0) / (state.fixes - state.strays + 1.0)
    sure = state.steady * np.log(np.minimum(odds, 1.0)) < math.log(MISTAKEN)
    return wrong & sure & (state.steady >= self.settings.lost_after)

  def _reckon(self, state: FilterState, some: Mask, accepted: Mask, lost: Mask) -> None:
    """Count fixes, and strays among them: also a vote that an accepted fix takes back was one."""
    fade, back = np.where(some, 1.0 - 1.0 / REMEMBERED, 1.0), accepted & ~lost & (state.steady > 0)
    state.fixes, state.strays = fade * state.fixes + some, fade * state.strays + back
    state.steady = np.where(lost, 0, state.steady - back)
    state.refused = np.where(accepted, 0, state.refused)

  def _fix_point(self, state: FilterState, place: Array, noise: Array, offset: Array, accepted: Mask) -> None:
    """A fix EKF_BM has accepted but EKF_PM cannot is the accelerometer's fault: start EKF_PM afresh."""
    there = np.isfinite(place) & (accepted & self.point_on(state))[:, None]
    values = place - offset[:, None] * state.point[:, 2:] if offset.any() else place
    trial = self._algebra.correct_together(state.point, state.point_covariance, PLACE_ROWS, values, noise, there)
    fits, some = self._judge(state, trial, there, POINT), there.any(axis=1)
    state.point = choose(some & fits, trial.state, state.point)
    state.point_covariance = choose(some & fits, trial.covariance, state.point_covariance)
    astray = some & ~fits
    if astray.any():
      state.refuse("pose", "gate of the point filter", astray)
      self._restart_point(state, astray)

  def _judge(self, state: FilterState, trial: Corrected, there: Mask, which: int) -> Mask:
    """Whether fixes of the components in `there` pass the gate; notes their NIS and evidence."""
    some, limit = there.any(axis=1), self._limits[np.count_nonzero(there, axis=1)]
    self.nis[:, which] = np.where(some, trial.nis, self.nis[:, which])
    worth = 0.5 * (np.minimum(trial.nis, limit) + trial.log_determinant)
    state.evidence = state.evidence - worth[:, None] * (np.arange(2) == which)
    return trial.nis <= limit
