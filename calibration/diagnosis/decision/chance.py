"""How far anything scanned on a data set gets by chance: sign flips of the scores of each second.

A mechanism's score in a second of driving is the slope of the fit along what it changes. Without any effect
it is as likely to be positive as negative. So with random signs e_k, the same for all M mechanisms that were scanned,

    z_m = |sum_k e_k h(s_mk)| / sqrt(sum_k h(s_mk)^2)        h(s) = sign(s) sqrt(|s|)

has the distribution that it has by chance, whatever the noise of a second and however alike two mechanisms are. So it
is for any odd function h; with the root one level serves a mechanism that acts in few seconds and one that acts in all.
The level is the quantile of the largest of z_1 ... z_M (Westfall and Young 1993, family-wise error). Divided by their
own norm, scores of a true effect do not raise it for others.
"""

import functools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.decision.evidence import Evidence, Named, Scanned
from calibration.diagnosis.decision.levels import Levels

Array = NDArray[np.float64]


def beyond_chance(name: Named, evidence: Evidence, levels: Levels) -> bool:
  """Whether a name's seconds agree more than those of anything scanned do by chance."""
  return consistency(name.scores) > _level(evidence.scanned, levels.family, int(levels.draws))


def consistency(scores: Sequence[float]) -> float:
  """|sum| over the norm of the scores' signed roots; 0 without any."""
  power = math.fsum(abs(s) for s in scores)
  return abs(math.fsum(_root(scores).tolist())) / math.sqrt(power) if power > 0.0 else 0.0


def _root(scores: Sequence[float]) -> Array:
  values = np.array(scores)
  return np.sign(values) * np.sqrt(np.abs(values))


@functools.lru_cache(maxsize=2)
def _level(scanned: tuple[Scanned, ...], family: float, draws: int) -> float:
  """What the largest of all that was scanned exceeds by chance with probability `family`."""
  rows = np.array([_root(s.scores) for s in scanned if consistency(s.scores) > 0.0])
  if not len(rows):
    return 0.0
  signs = np.random.default_rng(0).choice([-1.0, 1.0], (draws, rows.shape[1]))
  largest = np.max(np.abs(signs @ rows.T) / np.linalg.norm(rows, axis=1), axis=1)
  return float(np.quantile(largest, 1.0 - family))
