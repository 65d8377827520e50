"""Numbers of car and sensors that EKF_BM estimates beside its motion, as states that hardly change.

Linkage: the road wheels stand at (gain) command + (offset). Drive: (scale) times the commanded voltage acts. Encoder:
it says (scale) times the speed. Gyro: it says yaw rate + (bias). What is not unknown is what the settings say.
Source of the form: Simon, Optimal State Estimation, Wiley 2006, section 13.4 (parameters as states).

A number is learnt from what can tell of it. What a sensor has against the model says nothing of the sensor's own
number: that is learnt from the fixes. A car that is pushed harder than any floor is sure to hold teaches nothing that
tyres which give way would pass for. What is not to be learnt is considered: its uncertainty counts, it stays as it is
(Schmidt, 1966; Simon, section 10.5.1).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.models import BETA, R, V, lateral_by_steering
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.estimation.state import FilterState
from qcar_twin.estimation.watches.model import LEAST_GRIP

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
LINKAGE = ("steering_gain", "steering_offset")
TYRES = (*LINKAGE, "speed_scale", "drive_scale")  # what tyres that give way would pass for
MEASURED_WITH = {V: "speed_scale", R: "yaw_rate_bias"}  # by the row that is measured


class Unknowns:
  """What is known and unknown of N cars, whose memory is in their `FilterState`.

  Args:
    car: the single track, plain floats.
    settings: of the filter.
  """

  def __init__(self, car: SingleTrackCar, settings: FilterSettings):
    self._car, self._settings, self._rows = car, settings, settings.rows
    self._base = car.cg_to_front + car.cg_to_rear

  def of(self, state: FilterState, name: str) -> Any:
    """A number as it is known: (N,) where it is estimated, else the settings'."""
    said, row = getattr(self._settings, name), self._rows.get(name)
    return said if row is None else said + state.bicycle[:, row]

  def wheel_angle(self, state: FilterState) -> Array:
    """Of the road wheels behind the linkage, rad, (N,)."""
    return self.of(state, "steering_gain") * state.servo_angle + self.of(state, "steering_offset")

  # -- prediction --------------------------------------------------------------------------------

  def fill(self, transition: Array, state: FilterState, voltage: Array, following: Any) -> None:
    """Slopes of the next state by the unknown numbers into (N, n, n); settles which cars any floor holds.

    Args:
      state: before the prediction, with the wheels' angles that act.
      voltage: that acts, V, (N,).  following: speed after it, m/s, a float or (N,).
    """
    speed, h, rows = state.bicycle[:, V], self._settings.period, self._rows
    acceleration = (np.asarray(following) - speed) / h
    asked = np.hypot(state.wheel_angle * speed**2 / self._base, acceleration)
    state.holds = asked < LEAST_GRIP
    if "drive_scale" in rows:
      car = self._car
      moves = np.asarray(following) != 0.0  # a car at rest is held by friction
      transition[:, V, rows["drive_scale"]] = h * car.rolling_radius * car.drive_gain * voltage * moves
    if not any(name in rows for name in LINKAGE):
      return
    by_beta, by_rate = (np.asarray(s) for s in lateral_by_steering(speed, acceleration, self._car, h, np))
    for name, by in (("steering_gain", state.servo_angle), ("steering_offset", np.ones_like(speed))):
      if name in rows:
        transition[:, BETA, rows[name]], transition[:, R, rows[name]] = by_beta * by, by_rate * by

  # -- encoder and gyro --------------------------------------------------------------------------

  def as_said(self, state: FilterState, motion: Array) -> Array:
    """Measured speed and yaw rate, (N, 2), without what is known of encoder and gyro."""
    scale, bias = self.of(state, "speed_scale"), self.of(state, "yaw_rate_bias")
    return np.stack([motion[:, 0] / scale, motion[:, 1] - bias], axis=-1)

  def measured(self, state: FilterState, row: int) -> tuple[Array, Array]:
    """P h, (N, n), and h' P h, (N,), of a measured row, V or R, whose sensor may be unknown itself."""
    column, extra = state.bicycle_covariance[:, :, row], self._rows.get(MEASURED_WITH[row])
    if extra is None:
      return column, column[:, row]
    by = state.bicycle[:, V] / self.of(state, "speed_scale") if row == V else np.ones(len(column))
    column = column + by[:, None] * state.bicycle_covariance[:, :, extra]
    return column, column[:, row] + by * column[:, extra]

  def consider(self, state: FilterState, before: tuple[Array, Array], measured: int | None = None) -> None:
    """Undo what a correction has made of numbers that it cannot tell of.

    Args:
      state: corrected.
      before: state and covariance of EKF_BM before the correction.
      measured: row of the sensor, V or R; None for a fix.
    """
    own = () if measured is None else (MEASURED_WITH[measured],)
    for which, names in ((state.holds, own), (~state.holds, {*own, *TYRES})):
      rows = [row for name, row in self._rows.items() if name in names]
      if rows and which.any():
        cars = np.flatnonzero(which)
        state.bicycle, state.bicycle_covariance = state.bicycle.copy(), state.bicycle_covariance.copy()
        for array, old in zip((state.bicycle, state.bicycle_covariance), before, strict=True):
          block = np.ix_(cars, *[np.array(rows)] * (old.ndim - 1))
          array[block] = old[block]


def forget(state: FilterState, row: int, std: float, which: Mask) -> None:
  """Know an unknown number, of some cars, (N,), as at the start."""
  if not which.any():
    return
  state.bicycle, covariance = state.bicycle.copy(), state.bicycle_covariance.copy()
  state.bicycle[which, row] = 0.0
  covariance[which, row, :], covariance[which, :, row] = 0.0, 0.0
  covariance[which, row, row] = std**2
  state.bicycle_covariance = covariance
