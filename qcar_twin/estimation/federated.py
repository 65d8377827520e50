"""The federated filter of one car, online: `FederatedBatch` of one, whose samples come one by one, with times.

Measurements of any rate may come late and out of order.
"""

import math
from collections import Counter

import numpy as np

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.engines import Engine
from qcar_twin.estimation.estimate import BROKEN, Estimate, bounds_of, doubts, no_estimate
from qcar_twin.estimation.master import fuse_positions
from qcar_twin.estimation.models import YAW, X, Y
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.estimation.state import START_STD, Slot
from qcar_twin.estimation.timeline import Clock
from qcar_twin.estimation.watches.gyro import GyroWatch
from qcar_twin.estimation.watches.monitor import SpeedWatch, StampWatch
from qcar_twin.estimation.watches.silence import ANYWHERE
from qcar_twin.recordings.channels import COMMANDS, DRIVE_COMMANDS
from qcar_twin.recordings.recording import nearest

ACCEL, MOTION, FIX = ("accel_x", "accel_y"), ("speed", "yaw_rate"), ("pose_x", "pose_y", "pose_yaw", "pose_score")
_ASTRAY = 2  # periods by which stamps of one channel may be out of order
INPUTS = (*COMMANDS, *ACCEL)  # act from their slot until the next
TAKES = (*INPUTS, "motor_speed", *MOTION, *FIX)
_GROUPS = {"commands": COMMANDS, "accel": ACCEL, "motion": MOTION, "fix": FIX}  # columns of a slot's arrays
_PLACES = {name: (group, i) for group, names in _GROUPS.items() for i, name in enumerate(names)}


class FederatedFilter:
  """EKF_BM, EKF_PM and their master for one car.

  Call `update` with whatever arrives, `estimate` once per control period.

  Args:
    car: the identified single-track model.
    settings: noise, gates, limits.
    watched: whether encoder, gyro and stamps are watched for faults.
    engine: whose algebra predicts and corrects: "batched", or "filterpy" of the package of that name.

  Raises:
    MissingExtra: filterpy is asked for and not installed.
  """

  def __init__(
    self,
    car: SingleTrackCar,
    settings: FilterSettings | None = None,
    watched: bool = True,
    engine: Engine = "batched",
  ):
    self.settings = settings = settings or FilterSettings()
    self._reach = round(settings.buffer / settings.period)  # slots that may be written, back and ahead
    self._made_of = car, watched, engine
    self._batch = self._fresh()
    self._places = {**_PLACES, "motor_speed": _PLACES["speed"]}
    self._rolling_radius = self._batch.filters.car.rolling_radius
    self._clock = Clock(settings.period)
    self._not_taken: Counter[tuple[str, str]] = Counter()
    self._started: int | None = None  # slot of the first pose
    self._jumped = 0.0  # s, by which the clock was last set back
    self._recent_time, self._recent = math.nan, (0, 0.0, self._batch.slots[0])  # of the last sample, where it went
    self._latest: dict[str, float] = {}  # stamp of each channel's last sample, s
    self._onwards = False  # whether a sample since the last estimate was stamped after its channel's last
    self._held: list[tuple[float, str, float]] = []  # those that were stamped before it: late, or by another clock

  def _fresh(self) -> FederatedBatch:
    """A filter that knows nothing yet."""
    car, watched, engine = self._made_of
    return FederatedBatch(car, self.settings, 1, self._reach, self._reach, watched, math, engine)

  @property
  def refused(self) -> Counter[tuple[str, str]]:
    """How often a sample was not used, by (channel, reason): not taken in at all, or since the start left out."""
    return self._not_taken + self._batch.refused

  @property
  def nis(self) -> tuple[float, float]:
    """Of the last lidar fix in EKF_BM and in EKF_PM."""
    bicycle, point = self._batch.nis[0].tolist()
    return bicycle, point

  @property
  def evidence(self) -> tuple[float, float]:
    """Log likelihood of the fixes in EKF_BM and in EKF_PM, each counted once."""
    bicycle, point = self._batch.evidence[0].tolist()
    return bicycle, point

  @property
  def numbers(self) -> dict[str, tuple[float, float]]:
    """Numbers that EKF_BM estimates beside its motion, with their standard deviations; see `FilterSettings`.

    The gyro's bias is all of it, with what its watch has found.
    """
    state, settings = self._batch.state, self.settings
    value, variance = state.bicycle[0].tolist(), np.diagonal(state.bicycle_covariance[0]).tolist()
    watched = {"yaw_rate_bias": sum(watch.bias for watch in state.odometers)}
    return {
      name: (getattr(settings, name) + watched.get(name, 0.0) + value[i], math.sqrt(variance[i]))
      for name, i in settings.rows.items()
    }

  # -- what arrives ------------------------------------------------------------------------------

  def update(self, time: float, channel: str, value: float) -> None:
    """Take one sample with the time at which it was measured, s; the order of arrival does not matter.

    The drive's command goes by the name `motor_voltage`, in the unit that the car's drive_gain is per: also a duty, a
    current [A], a speed [m/s] or an acceleration [m/s^2].
    Not-finite values, repeated stamps and samples older than the buffer are refused and counted.

    Raises:
      KeyError: a channel the filter has no use for, with the nearest one.
    """
    if channel not in self._places:
      cure = f"; give it as '{COMMANDS[0]}', the drive's command in the unit that drive_gain is per"
      cure = cure if channel in DRIVE_COMMANDS else nearest(channel, TAKES)
      raise KeyError(f"the filter takes no channel '{channel}'{cure}")
    if not (math.isfinite(time) and math.isfinite(value)):
      self._not_taken[channel, "not finite"] += 1
      return
    latest = self._latest.get(channel, -math.inf)
    self._latest[channel] = time
    if time < latest - _ASTRAY * self.settings.period:
      self._held.append((time, channel, value))
      return
    self._onwards |= time > latest
    self._take(time, channel, value)

  def _take(self, time: float, channel: str, value: float) -> None:
    if time == self._recent_time:  # samples of one time come together
      index, offset, slot = self._recent
    else:
      index, offset = self._clock.place(time)
      reason = self._out_of_reach(index, channel)
      if reason is not None:
        self._not_taken[channel, reason] += 1
        return
      slot = self._batch.slots[index]
      if self._started is not None and index > self._started:
        self._recent_time, self._recent = time, (index, offset, slot)
    if self._put(slot, channel, value, offset):
      self._batch.spoil(index + (channel in INPUTS))
    else:
      self._not_taken[channel, "repeated"] += 1

  def _out_of_reach(self, index: int, channel: str) -> str | None:
    present = self._batch.present
    if not self._batch.slots.keeps(index):
      return "too late"
    if self._started is None:
      return None
    if present - self._reach <= index <= present + self._reach:
      return None if index > self._started or (index == self._started and channel in INPUTS) else "before the start"
    return "too late" if index < present else "in the future"

  def _put(self, slot: Slot, channel: str, value: float, offset: float) -> bool:
    """Store a sample; False when the slot already holds one. The last of two commands counts."""
    group, column = self._places[channel]
    if group == "fix" and slot.fix is None:
      slot.fix, slot.offset = np.full((1, len(FIX)), np.nan), offset
    row = getattr(slot, group)[0]
    fresh = channel in COMMANDS or math.isnan(row[column])
    if fresh:
      row[column] = value * self._rolling_radius if channel == "motor_speed" else value
    return fresh

  # -- the clock ---------------------------------------------------------------------------------

  def start(self, time: float, pose: tuple[float, float, float], speed: float = 0.0, std: float = 0.01) -> None:
    """Start from a known pose (m, m, rad; standard deviation `std`) and speed (m/s) instead of the first fix.

    Raises:
      ValueError: one of them is not finite, or `std` is not positive.
    """
    said = {"time": time, "x": pose[0], "y": pose[1], "yaw": pose[2], "speed": speed, "std": std}
    if wrong := [name for name, value in said.items() if not math.isfinite(value)]:
      raise ValueError(f"the filter cannot start: {', '.join(wrong)} not finite; without `start` it waits for a fix")
    if std <= 0.0:
      raise ValueError(f"the filter cannot start from a pose with a standard deviation of {std:g}; it must be positive")
    self._started = self._batch.present = self._clock.place(time)[0]
    self._batch.start(np.array([pose]), np.array([speed]), std)

  def estimate(self, time: float) -> Estimate:
    """Advance to a time, s, starting over from where late arrivals have changed the past, and report.

    A time further back than the buffer reaches means that the clock was set back, as does an earlier one where all
    samples since the last estimate are stamped before those of the same channel before them. The filter goes on by the
    new clock. One that was set forward is a silence for as long.

    Raises:
      ValueError: the time is not finite.
    """
    if not math.isfinite(time):
      raise ValueError(f"an estimate at the time {time}: ask with the time of the clock that stamps the samples, s")
    index, _ = self._clock.place(time)
    self._recent_time = math.nan
    if self._started is None:
      self._start_at_first_fix()
    if self._started is None:
      return no_estimate(time, "no pose has arrived yet")
    behind, held, together = self._batch.present - index, self._held, bool(self._held) and not self._onwards
    self._held, self._onwards = [], False
    if behind > self._reach or (behind > _ASTRAY and together):
      index = self._set_back(time)
    for sample in held:
      self._take(*sample)
    index = self._through_silence(max(index, self._batch.present), time)
    self._batch.go_to(index, self._clock.time(index))
    return self._report(time) if self._batch.state.sound[0] else self._begin_again(time)

  def _begin_again(self, time: float) -> Estimate:
    """Wait for the next fix, as at the beginning: what the filter knows is nothing to go on from."""
    self._batch, self._started = self._fresh(), None
    return no_estimate(time, BROKEN)

  def _set_back(self, time: float) -> int:
    """Index of a time, s, that lies further back than any sample may: the clock was set, and times go on from there."""
    index = self._batch.present + 1
    self._jumped = self._clock.time(index) - time
    self._clock.set(time, index)
    state = self._batch.state
    for watch in (*state.clocks, *state.watches):
      watch.restart()
    return index

  def _through_silence(self, index: int, time: float) -> int:
    """Slot of a time, s, of index `index` by the clock so far: after a silence, or a clock that was set forward, the
    periods beyond `ANYWHERE` are not gone through one by one."""
    furthest = self._batch.present + round((self.settings.buffer + ANYWHERE) / self.settings.period)
    if index <= furthest:
      return index
    self._batch.go_to(furthest, self._clock.time(furthest))
    self._batch.rest(index - furthest)
    self._clock.set(time, furthest)
    self._recent_time = math.nan
    return furthest

  def _start_at_first_fix(self) -> None:
    index = self._batch.slots.first_fix()
    if index is not None:
      slot = self._batch.slots[index]
      assert slot.fix is not None
      (x, y, yaw, _), (speed, _) = slot.fix[0].tolist(), slot.motion[0].tolist()
      self.start(self._clock.time(index), (x, y, yaw), 0.0 if math.isnan(speed) else speed, START_STD[0])

  # -- what is known -----------------------------------------------------------------------------

  def _report(self, time: float) -> Estimate:
    """The master's position and EKF_BM's motion, in plain floats."""
    state, settings = self._batch.state, self.settings
    bicycle, point = (state.bicycle[0], state.bicycle_covariance[0]), None
    x, y, speed, yaw, beta, rate, *_ = state.bicycle[0].tolist()
    (xx, xy, *_), (_, yy, *_), *_ = bicycle[1].tolist()
    position, spread = (x, y), (xx, xy, yy)
    honest = spread
    if self._batch.filters.point_on(state)[0]:
      point = state.point[0], state.point_covariance[0]
      (xx, xy, _, _), (_, yy, *_), *_ = point[1].tolist()
      position, spread = fuse_positions(position, spread, (point[0].item(X), point[0].item(Y)), (xx, xy, yy))
      if not min(spread[0], spread[2]) > 0.0:
        return self._begin_again(time)
    against = doubts(
      settings,
      max(spread[0], spread[2]),
      bicycle[1].item(YAW, YAW),
      state.age.item(),
      state.against.item(),
      state.silent.item(),
    )
    reasons = tuple(text.format(number) for wrong, text, number in against if wrong)
    honest = honest if sum(settings.sharing) > 1.0 else spread
    bounds = bounds_of(settings, honest, bicycle[1].item(YAW, YAW), state.hidden.item())
    warnings = self._warnings(point)
    return Estimate(time, *position, yaw, speed, beta, rate, spread, bicycle, point, reasons, warnings, bounds)

  def _warnings(self, point: object) -> tuple[str, ...]:
    state = self._batch.state
    warnings: list[str] = []
    for watch, clock, odometer in zip(state.watches, state.clocks, state.odometers, strict=True):
      warnings += self._found(watch, clock, odometer)
    if self._jumped:
      warnings.append(f"the clock was set back by {self._jumped:.3g} s; times go on from there")
    if point is None and not self.settings.central:
      warnings.append("no accelerometer: the point filter is left out")
    return tuple(warnings)

  def _found(self, watch: SpeedWatch, clock: StampWatch, odometer: GyroWatch) -> list[str]:
    """What the watches hold against the sensors."""
    warnings = []
    if not watch.believed:
      against = "contradicts the poses" if watch.doubted else "is frozen" if watch.frozen else "contradicts the filter"
      warnings.append(f"the encoder {against} and is left out")
    if odometer.doubted:
      warnings.append("the gyro contradicts the turns between poses and is left out")
    if odometer.bias:
      warnings.append(f"the gyro is taken to be off by {odometer.bias:+.3f} rad/s")
    if clock.delay > clock.slack:
      warnings.append(f"the poses are taken to be {1e3 * clock.delay:.0f} ms older than their stamps say")
    return warnings
