"""A held-out comparison of two models, as plain numbers."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.decision.levels import usual_levels

Array = NDArray[np.float64]

CAP = usual_levels().cap  # nats a block can bring to the decision
_LEAST_SPREAD = usual_levels().least_spread * CAP
_WIDE = usual_levels().wide * CAP


@dataclasses.dataclass(frozen=True)
class Comparison:
  """A model against a smaller one, by blocks of about three seconds.

  Attributes:
    gain: held-out drop of half the sum of squares, nats; at most CAP per block, so that no single
      event decides.
    t: mean over spread of the blocks' capped gains times the root of their number.
    share_positive: blocks that gained, 0 to 1, among those whose prediction moved at all.
    blocks: uncapped gain per block, B of them.
    before: held-out half sum of squares of the smaller model, nats.
    priors: nats by which the larger model's parameters lie closer to what was measured of the car.
    drop: nats by which the larger model fits better, its priors included.
    total: the gain with a hundred times wider cap: how much there is to explain at all.
  """

  gain: float
  t: float
  share_positive: float
  blocks: tuple[float, ...]
  before: float
  priors: float = 0.0
  drop: float = np.inf

  @property
  def relative(self) -> float:
    """Share of the held-out sum of squares that is explained."""
    return self.total / self.before if self.before > 0 else 0.0

  @property
  def standard_error(self) -> float:
    """Of the gain, nats, from the scatter of the blocks."""
    return standard_error(np.clip(self.blocks, -CAP, CAP))

  @property
  def t_with_priors(self) -> float:
    """The same t with what the priors gain counted as held out: what was measured of a car is no part of any block."""
    return (self.gain + self.priors) / self.standard_error

  @property
  def total(self) -> float:
    return float(np.clip(self.blocks, -_WIDE, _WIDE).sum())


def standard_error(capped: Array) -> float:
  """Of the sum of blocks' gains; inf where a single block shows no scatter."""
  count = len(capped)
  return max(float(np.std(capped, ddof=1)), _LEAST_SPREAD) * float(np.sqrt(count)) if count > 1 else np.inf
