"""The federated extended Kalman filter of one car, online: the paper's section on EKFs, no-reset mode.

Measurements of any rate may come late and out of order: every period's inputs, measurements and outcome
are kept for a while, and a late arrival makes the filter start over from its period.
"""

import math
from collections import Counter

from qcar_twin.estimation.estimate import Estimate, no_estimate
from qcar_twin.estimation.local_filters import START_STD, LocalFilters
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.estimation.timeline import POSE, Slot, Timeline
from qcar_twin.recording import COMMANDS, nearest
from qcar_twin.single_track import Car

INPUTS = (*COMMANDS, "accel_x", "accel_y")  # act from their slot until the next
TAKES = (*INPUTS, "motor_speed", "speed", "yaw_rate", *POSE, "pose_score")
_TAKEN = frozenset(TAKES)


class FederatedFilter:
  """EKF_BM, EKF_PM and their master for one car.

  Call `update` with whatever arrives, `estimate` once per control period.

  Args:
    car: the identified single-track model.
    settings: noise, gates, limits.
  """

  def __init__(self, car: Car, settings: FilterSettings | None = None):
    self.settings = settings or FilterSettings()
    self._filters = LocalFilters(car, self.settings)
    self._scale = {  # where a sample is kept, what is subtracted from it, what it is multiplied by
      **{name: (name, 0.0, 1.0) for name in (*COMMANDS, "speed")},
      **{name: (name, getattr(self.settings, f"{name}_bias"), 1.0) for name in ("accel_x", "accel_y", "yaw_rate")},
      "motor_speed": ("speed", 0.0, self._filters.car.rolling_radius),
    }
    self._timeline = Timeline(self.settings.period, self.settings.buffer)
    self._started: int | None = None  # slot of the first pose
    self._current = 0  # last slot passed
    self._recent_time, self._recent = math.nan, (0, 0.0, Slot())  # time of the last sample, and where it went
    self._dirty: int | None = None  # first slot whose outcome a late arrival has spoilt

  @property
  def refused(self) -> Counter[tuple[str, str]]:
    """How often a sample was not used, by (channel, reason); recounted when the past is filtered again."""
    return self._filters.refused

  @property
  def nis(self) -> tuple[float, float]:
    """Of the last lidar fix in EKF_BM and in EKF_PM."""
    return self._filters.nis

  @property
  def evidence(self) -> tuple[float, float]:
    """Log likelihood of the fixes in EKF_BM and in EKF_PM; counts a fix again when the past is filtered again."""
    bicycle, point = self._filters.evidence
    return bicycle, point

  # -- what arrives ------------------------------------------------------------------------------

  def update(self, time: float, channel: str, value: float) -> None:
    """Take one sample with the time at which it was measured, s; the order of arrival does not matter.

    Not-finite values, repeated stamps and samples older than the buffer are refused and counted.

    Raises:
      KeyError: a channel the filter has no use for, with the nearest one.
    """
    if channel not in _TAKEN:
      raise KeyError(f"the filter takes no channel '{channel}'{nearest(channel, TAKES)}")
    if not (math.isfinite(time) and math.isfinite(value)):
      self.refused[channel, "not finite"] += 1
      return
    if time == self._recent_time:  # samples of one time come together
      index, offset, slot = self._recent
    else:
      index, offset = self._timeline.place(time)
      reason = self._out_of_reach(index, channel)
      if reason is not None:
        self.refused[channel, reason] += 1
        return
      slot = self._timeline[index]
      if self._started is not None and index > self._started:
        self._recent_time, self._recent = time, (index, offset, slot)
    if not self._put(slot, channel, value, offset):
      self.refused[channel, "repeated"] += 1
    elif index <= self._current and self._started is not None:
      spoilt = index + (channel in INPUTS)
      if spoilt <= self._current:
        self._dirty = spoilt if self._dirty is None else min(self._dirty, spoilt)

  def _out_of_reach(self, index: int, channel: str) -> str | None:
    timeline = self._timeline
    if not timeline.keeps(index):
      return "too late"
    if self._started is None:
      return None
    if self._current - timeline.reach <= index <= self._current + timeline.reach:
      return None if index > self._started or (index == self._started and channel in INPUTS) else "before the start"
    return "too late" if index < self._current else "in the future"

  def _put(self, slot: Slot, channel: str, value: float, offset: float) -> bool:
    """Store a sample; False when the slot already holds one. The last of two commands counts."""
    if channel not in self._scale:
      if slot.pose is None:
        slot.pose, slot.offset = {}, offset
      fresh = channel not in slot.pose
      slot.pose.setdefault(channel, value)
      return fresh
    name, bias, scale = self._scale[channel]
    fresh = getattr(slot, name) is None or channel in COMMANDS
    if fresh:
      setattr(slot, name, (value - bias) * scale)
    return fresh

  # -- the clock ---------------------------------------------------------------------------------

  def start(self, time: float, pose: tuple[float, float, float], speed: float = 0.0, std: float = 0.01) -> None:
    """Start from a known pose (m, m, rad; standard deviation `std`) and speed (m/s) instead of the first fix."""
    index, _ = self._timeline.place(time)
    self._filters.start(pose, speed, std)
    self._timeline[index].outcome = self._filters.outcome
    self._started, self._current, self._dirty = index, index, None

  def estimate(self, time: float) -> Estimate:
    """Advance to a time, s, starting over from where late arrivals have changed the past, and report."""
    target, _ = self._timeline.place(time)
    self._recent_time = math.nan
    if self._started is None:
      self._start_at_first_fix()
    if self._started is None:
      return no_estimate(time, "no pose has arrived yet")
    first = self._current + 1
    if self._dirty is not None:
      first = self._dirty
      self._filters.restore(self._timeline[first - 1].outcome)
    for index in range(first, max(target, self._current) + 1):
      slot = self._timeline[index]
      self._filters.step(self._timeline[index - 1], slot, self._timeline.time(index))
      slot.outcome = self._filters.outcome
    self._current, self._dirty = max(target, self._current), None
    return self._filters.report(time)

  def _start_at_first_fix(self) -> None:
    index = self._timeline.first_fix()
    if index is not None:
      slot = self._timeline[index]
      x, y, yaw = ((slot.pose or {})[name] for name in POSE)
      self.start(self._timeline.time(index), (x, y, yaw), slot.speed or 0.0, START_STD[0])
