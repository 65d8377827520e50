"""The verdict: names against what they leave over.

A right name leaves what recordings without any effect leave, a wrong one does not. So the verdict looks at the
structure in the residuals of the model behind the claims; rivals without a name only say where it could come from.
"""

import dataclasses
from collections.abc import Sequence

from scipy.stats import gamma
from scipy.stats import t as student

from calibration.diagnosis.decision.claims import Claim
from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.decision.evidence import Evidence
from calibration.diagnosis.decision.levels import Levels
from calibration.diagnosis.decision.structure import Leftover


def strength(item: Leftover, levels: Levels) -> float:
  """A leftover's power in units of what it takes to be one; below 1 it is none.

  Of smooth structure the square of its share of the channel's spread, where noise would hardly make it; of a line its
  excess over what one in a smooth spectrum has by chance: the mean of n unit exponentials, less one; of bursts odds; of
  a whole error how many times the sensor's noise it is. A line or bursts of an immaterial size are none.
  """
  if item.count == 0:
    return 0.0
  if item.t is not None:
    by_chance = float(student.sf(item.t, max(item.count - 1, 1)))
    return (item.size / levels.material) ** 2 if by_chance < levels.chance else 0.0
  if item.family == "rhythm":
    level = float(gamma.isf(levels.rhythm, item.count)) / item.count - 1.0
  else:
    level = levels.error if item.family == "error" else levels.bursts
  return item.nats / level if item.size >= levels.material else 0.0


def above_level(found: Sequence[Leftover], levels: Levels) -> tuple[Leftover, ...]:
  """Leftovers that are some, strongest first, but whole errors, of which nothing else is known, last.

  Where a channel errs by what its sensor makes anyway nothing is left, whatever structure that has.
  """
  quiet = {i.channel for i in found if i.family == "error" and i.nats <= levels.good}
  order = lambda i: (i.family == "error", -strength(i, levels))
  return tuple(sorted((i for i in found if i.channel not in quiet and strength(i, levels) >= 1.0), key=order))


def judged(decision: Decision, evidence: Evidence, levels: Levels) -> tuple[str, ...]:
  """Which model's leftovers the verdict looks at: that behind the claims.

  Without a claim, what a mechanism explains that is there but too small to matter is no riddle, either: it is then
  the model of the first such mechanism. Names that are alike and too many to claim one are not too small: what they
  explain is left. The evidence holds what the recalibrated twin leaves.
  """
  small = decision.possible and not (decision.claims or decision.undecided)
  if small and above_level(evidence.left(()) or (), levels):
    return (decision.possible[0],)
  return decision.mechanisms


def conclude(
  decision: Decision, evidence: Evidence, levels: Levels, unknown: tuple[str, Comparison] | None = None
) -> Decision:
  """The decision with its verdict; as it is where the judged model's leftovers were not looked at.

  Args:
    decision: claims by name.
    evidence: with what the recalibrated twin and the judged model leave over.
    levels: what it takes to say that something nameless is there, and how much that makes names doubtful.
    unknown: the UNKNOWN rival that did best, with its held-out gain over the recalibrated twin.
  """
  before, after = evidence.left(()), evidence.left(judged(decision, evidence, levels))
  if before is None or after is None:
    return decision
  rest = above_level(after, levels)
  remains = bool(rest) and _share_left(before, rest, levels) > levels.remains
  claims, verdict = decision.claims, decision.verdict
  if remains:
    verdict = "partly_explained" if claims else "unexplained"
    claims = tuple(_doubted(c, levels) for c in claims)
  return dataclasses.replace(decision, verdict=verdict, claims=claims, unknown=unknown, leftovers=rest)


def _doubted(claim: Claim, levels: Levels) -> Claim:
  """A claim beside something nameless; names that can't be told from it are doubted with it."""
  probability, shared = levels.doubt * claim.probability, levels.doubt * claim.shared
  return dataclasses.replace(claim, probability=probability, shared=shared, certain=False)


def _share_left(before: Sequence[Leftover], rest: Sequence[Leftover], levels: Levels) -> float:
  """Of the strongest leftover, or of the largest error where that is more: strengths of errors and of structure are
  not of one scale."""
  shares = []
  for whole in (False, True):
    left, first = (
      max((strength(i, levels) for i in items if (i.family == "error") == whole), default=0.0)
      for items in (rest, before)
    )
    shares.append(left / max(left, first) if left else 0.0)
  return max(shares)
