"""Faults of a sensor over a stretch of time, for tests of what an estimator survives."""

import dataclasses
import math
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Kind = Literal["offset", "stuck", "lost", "not_finite"]


@dataclasses.dataclass(frozen=True)
class Fault:
  """One channel wrong from `start` to `end`.

  Attributes:
    channel: canonical name.
    kind: "offset" adds `size`; "stuck" reports `size`; "lost" gives no sample; "not_finite" reports
      infinity (a NaN that gets through is a sample like any other to the receiver).
    start, end: s after the first sample of the run; the end is open.
    size: in the channel's unit.
  """

  channel: str
  kind: Kind
  start: float
  end: float = math.inf
  size: float = 0.0

  def __post_init__(self) -> None:
    if self.kind not in get_args(Kind):
      raise ValueError(f"no fault '{self.kind}'; there are {', '.join(get_args(Kind))}")

  def apply(self, channels: tuple[str, ...], time: float, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Readings (N, c) of the named channels as the fault leaves them at a time, s."""
    if self.channel not in channels or not self.start <= time < self.end:
      return values
    column, values = channels.index(self.channel), values.copy()
    if self.kind == "offset":
      values[:, column] += self.size
    else:
      values[:, column] = {"stuck": self.size, "lost": np.nan, "not_finite": np.inf}[self.kind]
    return values
