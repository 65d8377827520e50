"""Faults of a sensor over a stretch of time, for tests of what an estimator survives."""

import dataclasses
import math
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from qcar_twin.sensors.streams import CarStreams

Kind = Literal["offset", "stuck", "frozen", "lost", "not_finite", "spikes", "late", "late_unsaid"]
Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Fault:
  """One channel wrong from `start` to `end`.

  Attributes:
    channel: canonical name.
    kind: "offset" adds `size`; "stuck" reports `size`; "frozen" repeats the last sample before the fault; "lost" gives
      no sample; "not_finite" reports infinity (a NaN that gets through is a sample like any other to the receiver);
      "spikes" adds or takes off `size` in some samples. "late" lets the samples of the channel's whole sensor arrive
      `size` s later than usual, with their true age; "late_unsaid" does so and their age is said to be the usual one.
    start, end: s after the first sample of the run; the end is open.
    size: in the channel's unit, or s.
    chance: of a spike, per sample.
  """

  channel: str
  kind: Kind
  start: float
  end: float = math.inf
  size: float = 0.0
  chance: float = 0.0

  def __post_init__(self) -> None:
    if self.kind not in get_args(Kind):
      raise ValueError(f"no fault '{self.kind}'; there are {', '.join(get_args(Kind))}")
    if not 0.0 <= self.chance <= 1.0 or (self.kind.startswith("late") and self.size < 0.0):
      raise ValueError(f"a chance lies in [0, 1], nothing arrives before it was measured: {self}")

  def acts(self, channels: tuple[str, ...], time: float) -> bool:
    """Whether it hits a sensor of these channels at a time, s."""
    return self.channel in channels and self.start <= time < self.end

  def delay(self, channels: tuple[str, ...], time: float) -> tuple[float, float]:
    """By how much what is measured at a time, s, arrives late, and how much of that its age conceals, s."""
    if not (self.kind.startswith("late") and self.acts(channels, time)):
      return 0.0, 0.0
    return self.size, self.size * (self.kind == "late_unsaid")


class FaultRun:
  """A fault of N cars under way.

  Args:
    fault: which.
    rng: of its spikes, nobody else's.
  """

  def __init__(self, fault: Fault, rng: np.random.Generator | CarStreams):
    self.fault, self._rng = fault, rng
    self._before: Array | None = None  # last sample of each car that was one and was not hit, (N,)

  def apply(self, channels: tuple[str, ...], time: float, values: Array) -> Array:
    """Readings (N, c) of the named channels as the fault leaves them at a time, s."""
    fault = self.fault
    if fault.channel not in channels:
      return values
    column = channels.index(fault.channel)
    if not fault.acts(channels, time):
      said = values[:, column]
      self._before = said.copy() if self._before is None else np.where(np.isfinite(said), said, self._before)
      return values
    values = values.copy()
    values[:, column] = self._faulty(values[:, column])
    return values

  def _faulty(self, said: Array) -> Array:
    fault = self.fault
    match fault.kind:
      case "offset":
        return said + fault.size
      case "frozen":
        return said if self._before is None else self._before
      case "spikes":
        lots = self._rng.random((2, len(said)))
        return said + np.where(lots[0] < fault.chance, np.where(lots[1] < 0.5, -fault.size, fault.size), 0.0)
      case "late" | "late_unsaid":
        return said
      case _:
        return np.full_like(said, {"stuck": fault.size, "lost": np.nan, "not_finite": np.inf}[fault.kind])
