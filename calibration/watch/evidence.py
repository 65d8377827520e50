"""Evidence at any time that a car has changed, in blocks of two seconds.

The residual e of a block, measured minus predicted, each channel over the size of its error on the recordings the twin
was checked on, and a change's signature d, what the twin would show with it minus what it shows, give

  a = d'W e / d'W d,  the change's size in that block in multiples of the watched one;  I = d'W d / k, its information.

W = (1 + B'B)^-1 is the weight where what differs from day to day is no news (generalised least squares): B are the
signatures, at one deviation each, of a sensor's zero and of the battery's charge. A yaw rate that is 0.3 % off in a
slow turn is as much a battery's as an axle's, and only the rest of it speaks for the axle.

k is how many times more a scatters within a reference recording than 1 / I says: residuals of neighbouring samples are
one witness. Nor is a's mean 0 in every kind of driving, since no twin is perfect. The means a_r of recordings scatter
about their centre c by s (DerSimonian and Laird, Controlled Clinical Trials 7, 1986), and, where driving shows the
change less, by more: an error of the twin that lasts has a size of its own, so it weighs as q / I, q the mean of
(a_r - c)^2 I_r beyond chance. So the null is not "nothing changed" but "no more than m",

  m = c + REACH sqrt(s^2 + q / I).

Blocks in which m is above LARGEST say nothing of the change. Against a constant change of size 1 the factor of a block
under that null has an expectation of at most 1 where a scatters as a Gaussian of variance 1 / I or less:

  L = exp(g I (a - m) - g^2 I / 2),  g = 1 - m

Nothing is believed more than CUT deviations in one block: I is taken for (CUT / g)^2 at the most, which claims a larger
variance than there is, and a is cut off there, which lowers L. The e-detector of Shin, Ramdas and Rinaldo (E-detectors,
New England Journal of Statistics in Data Science 2, 2024) adds the evidence over all times at which the change may have
begun, M_n = (M_{n-1} + 1) L_n. It exceeds A on average once in A blocks at the most, whatever the length of the drive
and however often one looks. A is set from RARE and the number of changes watched. The time the change began is the
start with the most evidence (Page's CUSUM).
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLOCK = 2.0  # s
RARE = 100.0 * 3600.0  # s of unchanged driving per false alarm at the most, all changes together
CUT = 3.0  # deviations
REACH = 1.645  # deviations of recordings' means: 95 of 100 kinds of driving show less
LARGEST = 0.7  # of the watched size: a null that reaches further leaves nothing to tell the change from


def sizes_of(residual: Array, signatures: Array, ordinary: Array) -> tuple[Array, Array]:
  """a and d'W d of every change, (K,) each; where nothing is shown both are 0.

  Args:
    residual: e of a block, (n,).
    signatures: d of each change, (K, n).
    ordinary: B, what differs from day to day, each at one deviation, (B, n).
  """
  inner = np.eye(len(ordinary)) + ordinary @ ordinary.T
  weighted = signatures - np.linalg.solve(inner, ordinary @ signatures.T).T @ ordinary
  information = np.maximum(np.sum(weighted * signatures, axis=1), 0.0)
  return np.divide(
    weighted @ residual, information, out=np.zeros(len(signatures)), where=information > 0.0
  ), information


@dataclasses.dataclass(frozen=True)
class Null:
  """What the reference says of one change in one direction, in multiples of the watched size.

  Attributes:
    centre, between, lasting, scatter: c, s, q and k.
  """

  centre: float
  between: float
  lasting: float
  scatter: float

  def reach(self, information: float) -> float:
    """m, what a block with d.d of `information` may show while nothing has changed."""
    known = information / self.scatter
    return max(0.0, self.centre + REACH * math.sqrt(self.between**2 + self.lasting / known))

  @property
  def watchable(self) -> bool:
    """Whether any driving can tell the change from what the twin errs anyway."""
    return self.centre + REACH * self.between <= LARGEST


def null_of(sizes: Array, information: Array, recording: NDArray[np.int64]) -> tuple[Null, Null]:
  """Nulls of a change and of its opposite, from a (n,) and d.d (n,) of n reference blocks and their recordings (n,)."""
  known = information > 0.0
  sizes, information, recording = sizes[known], information[known], recording[known]
  if len(sizes) < 3:
    nothing = Null(math.inf, 0.0, 0.0, 1.0)
    return nothing, nothing
  driven, row = np.unique(recording, return_inverse=True)
  weight = np.bincount(row, information)
  means = np.bincount(row, information * sizes) / weight
  freedom = max(len(sizes) - len(driven), 1)
  scatter = max(1.0, float(information @ (sizes - means[row]) ** 2) / freedom)
  own = weight / scatter
  centre = float(own @ means / own.sum())
  spread = own.sum() - float(own @ own) / own.sum()
  excess = float(own @ (means - centre) ** 2) - (len(driven) - 1)
  between = math.sqrt(max(excess / spread, 0.0)) if spread > 0.0 else math.inf
  count = np.bincount(row)
  beyond = (means - centre) ** 2 * own / count - 1.0 / count  # per block
  lasting = max(0.0, float(np.mean(beyond)))
  return Null(centre, between, lasting, scatter), Null(-centre, between, lasting, scatter)


class Detector:
  """One change in one direction, block after block.

  Attributes:
    evidence: log M.  since: time at which the change most probably began, s; NaN before any block, -inf where that was
      by a clock that has begun anew.
    size: its size since then, in multiples of the watched one.
    explained: half the sum of squares of residuals, as the reference scales them, that it explains since then.
  """

  def __init__(self, null: Null, watched: int):
    self.null = null
    self.threshold = math.log(watched * RARE / BLOCK)
    self.reset()

  def reset(self) -> None:
    """Forget all evidence."""
    self.evidence, self.since, self.size, self.explained = -math.inf, math.nan, math.nan, 0.0
    self._page, self._moment, self._weight = 0.0, 0.0, 0.0

  def begin_anew(self) -> None:
    """Times count from another zero from now on; evidence is of the car, and stays."""
    if self._page > 0.0:
      self.since = -math.inf

  def take(self, time: float, size: float, information: float) -> bool:
    """One block from `time` [s]; whether the evidence is enough for an alarm."""
    if not self.null.watchable or not (information > 0.0 and math.isfinite(size)):
      return False
    least = self.null.reach(information)
    if least > LARGEST:
      return False
    gain = 1.0 - least
    known = min(information / self.null.scatter, (CUT / gain) ** 2)
    beyond = min(size - least, CUT / math.sqrt(known))
    step = gain * known * beyond - 0.5 * gain * gain * known
    self.evidence = np.logaddexp(self.evidence, 0.0) + step
    if self._page <= 0.0:
      self._page, self.since, self._moment, self._weight = 0.0, time, 0.0, 0.0
    self._page += step
    self._moment, self._weight = self._moment + information * size, self._weight + information
    self.size = self._moment / self._weight
    self.explained = 0.5 * self._moment * self.size
    return bool(self.evidence >= self.threshold)

  def shown_by(self, information: float) -> bool:
    """Whether a block shows the change: one of the watched size gives a nat of evidence and more in it."""
    if not (information > 0.0 and self.null.watchable):
      return False
    gain = 1.0 - self.null.reach(information)
    return gain >= 1.0 - LARGEST and 0.5 * gain**2 * information / self.null.scatter >= 1.0
