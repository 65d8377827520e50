"""The verdict: names against what they leave over.

A right name leaves what recordings without any effect leave, a wrong one does not. So the verdict looks at the
structure in the residuals of the model behind the claims; rivals without a name only say where it could come from.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, compare_freely
from calibration.diagnosis.search.decide import Decision
from calibration.diagnosis.unexplained.leftover import Leftover, leftovers


@dataclasses.dataclass(frozen=True)
class UnexplainedLevels:
  """What it takes to say that something nameless is there; set by hand.

  Attributes:
    levels: held-out nats per block (per stretch for a rhythm; odds for bursts) of each family that recordings without
      effects stay below.
    usual: blocks or stretches the levels hold for.
    material: share of a channel's spread that a structure must make up: with quiet sensors the twin's own
      simplifications become visible.
    share: part of the recalibrated twin's own leftover (in units of its level) that may remain beside a right name:
      a formula right in kind is not right in every detail.
  """

  levels: Mapping[str, float] = dataclasses.field(
    default_factory=lambda: {
      "motion": 2.0, "commands": 1.5, "heading": 1.0, "place": 1.0, "history": 1.6, "rhythm": 1.6, "bursts": 2.3,
    }
  )  # fmt: skip
  usual: int = 30
  material: float = 0.02
  share: float = 0.35

  def strength(self, item: Leftover) -> float:
    """A leftover in units of its family's level, which is higher where fewer blocks leave more to chance."""
    chance = np.sqrt(max(self.usual / item.count, 1.0)) if item.count else 1.0
    return float(item.nats / (self.levels[item.family] * chance))


def above_level(found: Sequence[Leftover], levels: UnexplainedLevels) -> tuple[Leftover, ...]:
  """Leftovers beyond their level and of a size that matters, strongest first."""
  seen = (i for i in found if levels.strength(i) >= 1.0 and not i.size < levels.material)
  return tuple(sorted(seen, key=lambda i: -levels.strength(i)))


def left_over(decision: Decision, pool: Pool, levels: UnexplainedLevels) -> tuple[list[Leftover], list[Leftover]]:
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
  levels: UnexplainedLevels = UnexplainedLevels(),
) -> Decision:
  """The decision with its verdict.

  Args:
    decision: claims by name.
    pool: all fitted models.
    before, after: what the recalibrated twin and the model behind the claims leave over.
    unknowns: UNKNOWN rivals, set against the recalibrated twin.
    levels: what it takes to say that something nameless is there.
  """
  rest = above_level(after, levels)
  remains = bool(rest) and _share_left(before, rest, levels) > levels.share
  claims, verdict = decision.claims, decision.verdict
  if remains:
    verdict = "partly_explained" if claims else "unexplained"
    claims = tuple(dataclasses.replace(c, probability=0.5 * c.probability, certain=False) for c in claims)
  unknown = best_unknown(pool, unknowns)
  return dataclasses.replace(decision, verdict=verdict, claims=claims, unknown=unknown, leftovers=rest)


def best_unknown(pool: Pool, unknowns: Mapping[str, Candidate]) -> tuple[str, Comparison] | None:
  """The UNKNOWN rival with the largest held-out gain over the recalibrated twin."""
  scored = {name: compare_freely(model, pool.base, pool.problem.observations) for name, model in unknowns.items()}
  return max(scored.items(), key=lambda kv: kv[1].gain, default=None)


def _share_left(before: Sequence[Leftover], rest: Sequence[Leftover], levels: UnexplainedLevels) -> float:
  strongest = max((levels.strength(i) for i in before), default=0.0)
  return levels.strength(rest[0]) / max(strongest, levels.strength(rest[0]))
