"""The verdict: names against what they leave over and against rivals without a name.

A right name leaves what recordings without any effect leave, a wrong one does not. So the verdict looks at the
structure in the residuals of the model behind the claims, and at UNKNOWN rivals set against the same recalibrated twin.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.detect import Detection
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, compare, compare_freely
from calibration.diagnosis.search.decide import Decision
from calibration.diagnosis.unexplained.leftover import Leftover, leftovers
from calibration.diagnosis.unexplained.residual_magnitude import worst_relative_error

# what a verdict becomes where the model behind it misses more of the motion than it should
DOUBTED = {"explained": "partly_explained", "no_mismatch": "unexplained"}


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
    factor: by which an UNKNOWN rival must beat the named model where nothing is left over.
    least: nats it must be ahead.
    explains: share of the held-out sum of squares it must explain.
    t: and its lead over its standard error.
    loud: by which a detector must exceed its level to say so without a name or a leftover.
    heard: detectors that may. The exponent of the pose error tells too little, and drift is measured against the
      noise: where sensors are quiet, a parameter that differs by a per cent is far above it.
  """

  levels: Mapping[str, float] = dataclasses.field(
    default_factory=lambda: {
      "motion": 2.0, "commands": 1.5, "heading": 1.0, "place": 1.0, "history": 1.6, "rhythm": 1.6, "bursts": 2.3,
    }
  )  # fmt: skip
  usual: int = 30
  material: float = 0.02
  share: float = 0.35
  factor: float = 1.25
  least: float = 40.0
  explains: float = 0.2
  t: float = 3.0
  loud: float = 1.25
  heard: tuple[str, ...] = ("predictability", "priors")

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
  rest, unknown = above_level(after, levels), best_unknown(pool, unknowns)
  remains = bool(rest) and _share_left(before, rest, levels) > levels.share
  beaten = _beaten(decision, pool, unknown, unknowns, levels)
  claims, verdict = decision.claims, decision.verdict
  if beaten or (remains and not claims):
    verdict = "unexplained"
  elif remains:
    verdict = "partly_explained"
  missed = worst_relative_error(decision.model, pool)
  far_off = missed is not None and missed.strength > 1.0
  if far_off:
    verdict = DOUBTED.get(verdict, verdict)
  if verdict != decision.verdict:
    claims = tuple(dataclasses.replace(c, probability=0.5 * c.probability, certain=False) for c in claims)
  alarm = missed.sentence if missed is not None and far_off else decision.alarm
  return dataclasses.replace(decision, verdict=verdict, claims=claims, unknown=unknown, leftovers=rest, alarm=alarm)


def apply_alarms(decision: Decision, detection: Detection, levels: UnexplainedLevels = UnexplainedLevels()) -> Decision:
  """The decision, `unexplained` where nothing was found but a detector is far above its level."""
  loudest = max((detection[name] for name in levels.heard), key=lambda d: d.statistic / d.threshold)
  if decision.verdict != "no_mismatch" or loudest.statistic <= levels.loud * loudest.threshold:
    return decision
  return dataclasses.replace(decision, verdict="unexplained", alarm=loudest.sentence)


def best_unknown(pool: Pool, unknowns: Mapping[str, Candidate]) -> tuple[str, Comparison] | None:
  """The UNKNOWN rival with the largest held-out gain over the recalibrated twin."""
  scored = {name: compare_freely(model, pool.base, pool.problem.observations) for name, model in unknowns.items()}
  return max(scored.items(), key=lambda kv: kv[1].gain, default=None)


def _share_left(before: Sequence[Leftover], rest: Sequence[Leftover], levels: UnexplainedLevels) -> float:
  strongest = max((levels.strength(i) for i in before), default=0.0)
  return levels.strength(rest[0]) / max(strongest, levels.strength(rest[0]))


def _beaten(
  decision: Decision,
  pool: Pool,
  unknown: tuple[str, Comparison] | None,
  unknowns: Mapping[str, Candidate],
  levels: UnexplainedLevels,
) -> bool:
  """Whether a nameless rival explains clearly more than the names do."""
  if unknown is None or unknown[1].t <= levels.t or unknown[1].relative <= levels.explains:
    return False
  observations, named = pool.problem.observations, decision.model
  known = compare(named, pool.base, observations).gain if named.mechanisms else 0.0
  ahead = compare_freely(unknowns[unknown[0]], named, observations)
  return unknown[1].gain > levels.factor * known + levels.least and ahead.t > levels.t
