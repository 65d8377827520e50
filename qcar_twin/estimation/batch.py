"""The federated extended Kalman filter of N cars: the paper's section on EKFs, no-reset mode.

All cars share one clock with one slot per period. A late measurement makes the filter start over from its slot.
`FederatedFilter` is the same for one car whose samples come one by one, with times.
"""

from collections import Counter
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.engines import Engine
from qcar_twin.estimation.estimate import BatchEstimate, bounds_of, doubts
from qcar_twin.estimation.local_filters import LocalFilters
from qcar_twin.estimation.master import fuse_positions
from qcar_twin.estimation.models import BETA, YAW, R, V, X, Y
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.estimation.state import REFUSALS, FilterState, Slot
from qcar_twin.estimation.timeline import Timeline

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class FederatedBatch:
  """EKF_BM, EKF_PM and their master for N cars.

  Each period: `advance` with what has been measured, `estimate`, `command`.

  Args:
    car: the identified model, one for all cars.
    settings: noise, gates, limits.
    count: N.
    oldest: age of the oldest fix that may arrive, periods.
    ahead: how far beyond the present slots may be written, periods.
    watched: whether encoders, gyros and stamps are watched for faults (`SpeedWatch`, `GyroWatch`, `StampWatch`).
    lib: steps the models: `numpy`, or for one car `math`.
    engine: whose algebra predicts and corrects: "filterpy" for one car only.
  """

  def __init__(
    self,
    car: SingleTrackCar,
    settings: FilterSettings,
    count: int,
    oldest: int = 10,
    ahead: int = 0,
    watched: bool = False,
    lib: ModuleType = np,
    engine: Engine = "batched",
  ):
    self.settings, self.count = settings, count
    self.filters = LocalFilters(car, settings, count, lib, engine)
    self.slots = Timeline(count, oldest + ahead + 2)  # also the one that the oldest goes on from, and the present
    self.present = 0  # last slot passed
    self._oldest, self._watched = oldest, watched
    self._due = 1  # first slot that has not been passed, or whose past a late arrival has changed
    self._begun = np.zeros(count, dtype=np.int64)  # slot in which each car was started
    self.state = self._beginning = self._fresh(np.zeros((count, 3)), np.zeros(count), 0.0)
    self.slots[0].outcome = self.state

  @property
  def nis(self) -> Array:
    """Of the last lidar fix in EKF_BM and in EKF_PM, (N, 2)."""
    return self.filters.nis

  @property
  def evidence(self) -> Array:
    """Log likelihood of the fixes since each car was started, in EKF_BM and in EKF_PM, (N, 2); for fitting the noise.

    Each fix counts once, however often its period is passed: it belongs to the state.
    """
    return self.state.evidence

  @property
  def refused(self) -> Counter[tuple[str, str]]:
    """How often a measurement was not used since its car was started, by (channel, reason), all cars together."""
    counts = self.state.turned_away.sum(axis=0).tolist()
    return Counter({why: count for why, count in zip(REFUSALS, counts, strict=True) if count})

  def start(self, pose: Array, speed: Array, std: float = 0.01, which: Mask | None = None) -> None:
    """Start cars (all, or those of a mask) at known poses (N, 3) and speeds (N,) in the present period.

    Measurements of the masked cars from before are discarded.
    """
    fresh = self._fresh(pose, speed, std)
    slot = self.slots[self.present]
    if which is None:
      which = np.ones(self.count, dtype=bool)
    else:
      slot.commands, slot.accel = (np.where(which[:, None], np.nan, a) for a in (slot.commands, slot.accel))
    self.state, self._beginning = self.state.copy(), self._beginning.copy()
    self.state.put(which, fresh)
    self._beginning.put(which, fresh)
    self._begun = np.where(which, self.present, self._begun)
    slot.outcome, self._due = self.state, self.present + 1

  def _fresh(self, pose: Array, speed: Array, std: float) -> FilterState:
    settings = self.settings
    return FilterState.at(pose, speed, std, self._watched, tuple(settings.unknown.values()), max(settings.delays))

  def command(self, commands: Array) -> None:
    """Voltage [V] and steering command [rad] applied from the present period on, (N, 2)."""
    self.slots[self.present].commands = np.array(commands, dtype=np.float64)

  def advance(self, motion: Array, accel: Array, fix: Array | None = None, age: int = 0) -> None:
    """Go on by one period; NaN is no sample.

    Args:
      motion: speed [m/s] and yaw rate [rad/s] measured at its end, (N, 2).
      accel: at the IMU, m/s^2, (N, 2), acting from its end on.
      fix: lidar x, y [m], yaw [rad], score, measured `age` periods before its end, (N, 4).

    Raises:
      ValueError: the fix is older than kept, or something is not of N cars.
    """
    for name, given, width in (("motion", motion, 2), ("accel", accel, 2), ("fix", fix, 4)):
      if given is not None and np.shape(given) != (self.count, width):
        raise ValueError(f"{name} of shape {np.shape(given)}; {self.count} cars have ({self.count}, {width})")
    if not 0 <= age <= self._oldest:
      raise ValueError(f"a fix of age {age} periods; at most {self._oldest} are kept, raise `oldest`")
    slot = self.slots[self.present + 1]
    slot.motion, slot.accel = np.array(motion, dtype=np.float64), np.array(accel, dtype=np.float64)
    measured = self.present + 1 - age
    if fix is not None and measured > 0:
      self.slots[measured].fix = np.where((self._begun < measured)[:, None], fix, np.nan)
      self.spoil(measured)
    self.go_to(self.present + 1)

  def spoil(self, index: int) -> None:
    """Say that something has been written into a slot after the filter has passed it."""
    self._due = min(self._due, index)

  def go_to(self, index: int, time: float | None = None) -> None:
    """Pass all slots up to one that is not before the present; `time` of it, s, if not index times period."""
    period = self.settings.period
    origin = 0.0 if time is None else time - index * period
    before = self.slots[self._due - 1]
    for k in range(self._due, index + 1):
      slot = self.slots[k]
      slot.outcome = self._passed(before, slot, k, origin + k * period)
      before = slot
    assert before.outcome is not None
    self.state, self.present, self._due = before.outcome, index, index + 1

  def rest(self, periods: int) -> None:
    """Let so many periods of silence pass at the present, of which nothing but their length is told any more."""
    settings, state = self.settings, self.state.copy()
    span = periods * settings.period
    state.age, state.silent, state.accel_age = state.age + span, state.silent + span, state.accel_age + span
    state.bicycle_covariance = state.bicycle_covariance + periods * settings.bicycle_noise
    self.state = self.slots[self.present].outcome = state

  def _passed(self, before: Slot, now: Slot, index: int, time: float) -> FilterState:
    assert before.outcome is not None
    state = self.filters.step(before.outcome, before, now, time)
    waiting = self._begun >= index  # cars that were started later than this replayed period
    if waiting.any():
      state.put(waiting, self._beginning)
    return state

  def estimate(self) -> BatchEstimate:
    """The master's position and EKF_BM's motion at the present period."""
    state, settings = self.state, self.settings
    bicycle, point = state.bicycle_covariance, state.point_covariance
    own, spread = (state.bicycle[:, X], state.bicycle[:, Y]), (bicycle[:, X, X], bicycle[:, X, Y], bicycle[:, Y, Y])
    other, other_spread = (state.point[:, X], state.point[:, Y]), (point[:, X, X], point[:, X, Y], point[:, Y, Y])
    fused, fused_spread = fuse_positions(own, spread, other, other_spread)
    on = self.filters.point_on(state)
    x, y = (np.where(on, a, b) for a, b in zip(fused, own, strict=True))
    covariance = np.stack([np.where(on, a, b) for a, b in zip(fused_spread, spread, strict=True)], axis=-1)
    v, beta, yaw = state.bicycle[:, V], state.bicycle[:, BETA], state.bicycle[:, YAW]
    largest = np.maximum(covariance[:, 0], covariance[:, 2])
    against = doubts(settings, largest, bicycle[:, YAW, YAW], state.age, state.against, state.silent)
    valid = (
      state.sound
      & (covariance[:, [0, 2]] > 0.0).all(axis=1)
      & ~np.logical_or.reduce([wrong for wrong, _, _ in against])
    )
    pose = np.stack([x, y, yaw], axis=-1)
    velocity = np.stack([v * np.cos(beta), v * np.sin(beta)], axis=-1)
    honest = spread if sum(settings.sharing) > 1.0 else covariance.T
    bounds = np.stack(bounds_of(settings, honest, bicycle[:, YAW, YAW], state.hidden), axis=-1)
    return BatchEstimate(pose, velocity, v, beta, state.bicycle[:, R], covariance, valid, bounds)
