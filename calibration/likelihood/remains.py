"""What still pushes the car once names are fitted: the smoothed forces, and what they depend on.

Nameless families compete as hypotheses do: each is a block of columns with a prior, and counts where its marginal
likelihood exceeds what the best of them reaches under random signs of the blocks.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from calibration.likelihood.body_force import FORCES
from calibration.likelihood.hypotheses import families, pushed, weigh
from calibration.likelihood.levels import Levels
from calibration.likelihood.refit import Minimum, prior_of


@dataclasses.dataclass(frozen=True)
class Remains:
  """Attributes:
  gains: nats of every family.  level: that the best of them reaches by chance.
  depends_on: families above it, most nats first.
  forces: root mean square of each smoothed force, N and N m.
  """

  gains: Mapping[str, float]
  level: float
  depends_on: tuple[str, ...]
  forces: Mapping[str, float]

  @property
  def significant(self) -> bool:
    return bool(self.depends_on)


def remains(at: Minimum, limits: Levels) -> Remains:
  """The families at a minimum."""
  place, tables = at.place, families(at.place.readings, at.starts)
  parts = [pushed(place, table) for table in tables.values()]
  columns, ends, width = (np.concatenate([p[k] for p in parts], axis=-1) for k in range(3))
  white, _ = place.whiten(at.noise, place.residual, place.gap, at.starts, columns, ends)
  edges = np.cumsum([0, *(len(p[2]) for p in parts)])
  where = [slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
  pull = -prior_of(at.free, at.values) / at.free.std
  weighed = weigh(at.white.rows(slice(1, None)), at.precision, pull, place.readings.block, at.white.rows(0),
                  white.rows(slice(1, None)), where, width, np.zeros(len(width), dtype=bool), limits.draws)  # fmt: skip
  level = max(float(np.quantile(weighed.chance, 1.0 - limits.family_wise)), 0.0)
  gains = dict(zip(tables, weighed.gain.tolist(), strict=True))
  above = tuple(name for name in sorted(gains, key=lambda n: -gains[n]) if gains[name] > level)
  _, others = place.smoothed(at.noise, place.residual, place.gap, at.starts)
  forces: dict[str, float] = dict(zip(FORCES, np.sqrt(np.mean(others[:, :3] ** 2, axis=0)).tolist(), strict=True))
  return Remains(gains, level, above, forces)
