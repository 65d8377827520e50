"""The recent past of a filter: one slot per period, so that late measurements find their place."""

import dataclasses
from collections import deque
from typing import Any

POSE = ("pose_x", "pose_y", "pose_yaw")


@dataclasses.dataclass(slots=True)
class Slot:
  """One period: what came in, and the filter after it.

  Attributes:
    motor_voltage, steering_command, accel_x, accel_y: inputs from this slot on, V, rad, m/s^2; None for no news.
    speed, yaw_rate: measured, m/s and rad/s.
    pose: measured, by channel; None for no fix.
    offset: stamp of the fix after the slot's own time, s.
    outcome: whatever the filter needs to go on from here; None while it has not passed.
  """

  motor_voltage: float | None = None
  steering_command: float | None = None
  accel_x: float | None = None
  accel_y: float | None = None
  speed: float | None = None
  yaw_rate: float | None = None
  pose: dict[str, float] | None = None
  offset: float = 0.0
  outcome: Any = None


class Timeline:
  """Slots by index: index k is the time origin + k period.

  Args:
    period: s.
    buffer: how far back (and ahead) slots are kept, s.
  """

  def __init__(self, period: float, buffer: float):
    self.period = period
    self.reach = round(buffer / period)  # slots
    self._slots: deque[Slot] = deque(maxlen=2 * self.reach + 1)
    self._first = 0
    self._origin: float | None = None
    self._asked, self._answer = float("nan"), (0, 0.0)  # samples of one time come together

  def place(self, time: float) -> tuple[int, float]:
    """Index of the nearest slot and the time left over, s. The first time ever asked for is the origin."""
    if time == self._asked:
      return self._answer
    if self._origin is None:
      self._origin = time
    index = round((time - self._origin) / self.period)
    self._asked, self._answer = time, (index, time - self._origin - index * self.period)
    return self._answer

  def time(self, index: int) -> float:
    """Time of a slot, s."""
    return (self._origin or 0.0) + index * self.period

  def __getitem__(self, index: int) -> Slot:
    """A slot, made (with all before it) when it lies ahead.

    Raises:
      IndexError: it is no longer kept.
    """
    if 0 <= index - self._first < len(self._slots):
      return self._slots[index - self._first]
    if not self._slots or index >= self._first + 2 * len(self._slots) + 2 * self.reach:
      self._slots.clear()  # after a silence longer than anything kept
      self._first = index
    if index < self._first:
      raise IndexError(f"slot {index} is no longer kept; the oldest is {self._first}")
    while index >= self._first + len(self._slots):
      self._first += len(self._slots) == self._slots.maxlen
      self._slots.append(Slot())
    return self._slots[index - self._first]

  def keeps(self, index: int) -> bool:
    """Whether a slot can still be reached."""
    return not self._slots or index >= self._first

  def first_fix(self) -> int | None:
    """Index of the oldest slot with a complete pose."""
    for index, slot in enumerate(self._slots, start=self._first):
      if slot.pose is not None and all(name in slot.pose for name in POSE):
        return index
    return None
