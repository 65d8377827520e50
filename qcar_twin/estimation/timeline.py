"""The recent past of a filter: one slot per period, so that late measurements find their place."""

from collections import deque

import numpy as np

from qcar_twin.estimation.state import Slot


class Clock:
  """Times and periods: slot k is the time origin + k period, the first time ever asked for the origin.

  Args:
    period: s.
  """

  def __init__(self, period: float):
    self.period = period
    self._origin: float | None = None
    self._asked, self._answer = float("nan"), (0, 0.0)  # samples of one time come together

  def place(self, time: float) -> tuple[int, float]:
    """Index of the nearest slot and the time left over, s."""
    if time == self._asked:
      return self._answer
    if self._origin is None:
      self._origin = time
    index = round((time - self._origin) / self.period)
    self._asked, self._answer = time, (index, time - self._origin - index * self.period)
    return self._answer

  def set(self, time: float, index: int) -> None:
    """Let slot `index` be at a time, s, from now on."""
    self._origin, self._asked = time - index * self.period, float("nan")

  def time(self, index: int) -> float:
    """Time of a slot, s."""
    return (self._origin or 0.0) + index * self.period


class Timeline:
  """Slots of N cars by index; the newest `kept` of them.

  Args:
    count: N.
    kept: how many.
  """

  def __init__(self, count: int, kept: int):
    self._count, self._kept = count, kept
    self._slots: deque[Slot] = deque(maxlen=kept)
    self._first = 0

  def __getitem__(self, index: int) -> Slot:
    """A slot, made (with all before it) when it lies ahead.

    Raises:
      IndexError: it is no longer kept.
    """
    if 0 <= index - self._first < len(self._slots):
      return self._slots[index - self._first]
    if not self._slots or index >= self._first + 2 * len(self._slots) + self._kept - 1:
      self._slots.clear()  # after a silence longer than anything kept
      self._first = index
    if index < self._first:
      raise IndexError(f"slot {index} is no longer kept; the oldest is {self._first}")
    while index >= self._first + len(self._slots):
      self._first += len(self._slots) == self._kept
      self._slots.append(Slot.empty(self._count))
    return self._slots[index - self._first]

  def keeps(self, index: int) -> bool:
    """Whether a slot can still be reached."""
    return not self._slots or index >= self._first

  def first_fix(self) -> int | None:
    """Index of the oldest slot with a complete pose of the first car."""
    for index, slot in enumerate(self._slots, start=self._first):
      if slot.fix is not None and np.isfinite(slot.fix[0, :3]).all():
        return index
    return None
