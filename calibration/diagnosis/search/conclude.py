"""The verdict: names against what they leave over.

A right name leaves what recordings without any effect leave, a wrong one does not. So the verdict looks at the
structure in the residuals of the model behind the claims; rivals without a name only say where it could come from.
"""

import dataclasses
from collections.abc import Mapping, Sequence

from scipy.stats import gamma
from scipy.stats import t as student

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, compare_freely
from calibration.diagnosis.search.decide import Decision
from calibration.diagnosis.search.weighing import Levels
from calibration.diagnosis.unexplained.leftover import Leftover, leftovers


def strength(item: Leftover, levels: Levels) -> float:
  """A leftover's power in units of what it takes to be one; below 1 it is none.

  Of smooth structure the square of its share of the channel's spread, where noise would hardly make it; of a line its
  excess over what one in a smooth spectrum has by chance: the mean of n unit exponentials, less one; of bursts odds.
  """
  if item.count == 0:
    return 0.0
  if item.comparison is not None:
    by_chance = float(student.sf(item.comparison.t, max(len(item.comparison.blocks) - 1, 1)))
    return (item.size / levels.material) ** 2 if by_chance < levels.chance else 0.0
  if item.line is not None:
    return item.nats / (float(gamma.isf(levels.rhythm, item.count)) / item.count - 1.0)
  return item.nats / levels.bursts if item.size >= levels.material else 0.0


def above_level(found: Sequence[Leftover], levels: Levels) -> tuple[Leftover, ...]:
  """Leftovers that are some, strongest first."""
  return tuple(sorted((i for i in found if strength(i, levels) >= 1.0), key=lambda i: -strength(i, levels)))


def left_over(decision: Decision, pool: Pool, levels: Levels) -> tuple[list[Leftover], list[Leftover]]:
  """Structure in the residuals of the recalibrated twin, and of the model behind the claims.

  Without a claim, what a mechanism explains that is there but too small to matter is no riddle, either: the second
  is then that of the first such mechanism.
  """
  over = lambda m: leftovers(m, pool.problem, pool.problem.exact.predict(m.theta[None]))
  before, named = over(pool.base), decision.model
  if not decision.claims and decision.possible and above_level(before, levels):
    named = pool.models[frozenset([decision.possible[0]])]
  return before, over(named) if named.mechanisms else before


def conclude(
  decision: Decision,
  pool: Pool,
  before: Sequence[Leftover],
  after: Sequence[Leftover],
  unknowns: Mapping[str, Candidate],
  levels: Levels,
) -> Decision:
  """The decision with its verdict.

  Args:
    decision: claims by name.
    pool: all fitted models.
    before, after: what the recalibrated twin and the model behind the claims leave over.
    unknowns: UNKNOWN rivals, set against the recalibrated twin.
    levels: what it takes to say that something nameless is there, and how much that makes names doubtful.
  """
  rest = above_level(after, levels)
  remains = bool(rest) and _share_left(before, rest, levels) > levels.remains
  claims, verdict = decision.claims, decision.verdict
  if remains:
    verdict = "partly_explained" if claims else "unexplained"
    claims = tuple(dataclasses.replace(c, probability=levels.doubt * c.probability, certain=False) for c in claims)
  unknown = best_unknown(pool, unknowns)
  return dataclasses.replace(decision, verdict=verdict, claims=claims, unknown=unknown, leftovers=rest)


def best_unknown(pool: Pool, unknowns: Mapping[str, Candidate]) -> tuple[str, Comparison] | None:
  """The UNKNOWN rival with the largest held-out gain over the recalibrated twin."""
  scored = {name: compare_freely(model, pool.base, pool.problem.observations) for name, model in unknowns.items()}
  return max(scored.items(), key=lambda kv: kv[1].gain, default=None)


def _share_left(before: Sequence[Leftover], rest: Sequence[Leftover], levels: Levels) -> float:
  strongest = max((strength(i, levels) for i in before), default=0.0)
  return strength(rest[0], levels) / max(strongest, strength(rest[0], levels))
