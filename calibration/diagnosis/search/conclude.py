"""The verdict: names against what they leave over.

A right name leaves what recordings without any effect leave, a wrong one does not. So the verdict looks at the
structure in the residuals of the model behind the claims; rivals without a name only say where it could come from.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import gamma
from scipy.stats import t as student

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, compare_freely
from calibration.diagnosis.search.decide import Decision
from calibration.diagnosis.search.weighing import Levels
from calibration.diagnosis.unexplained.leftover import Leftover, leftovers
from calibration.fitting.residual_channels import RESIDUALS


def strength(item: Leftover, levels: Levels) -> float:
  """A leftover's power in units of what it takes to be one; below 1 it is none.

  Of smooth structure the square of its share of the channel's spread, where noise would hardly make it; of a line its
  excess over what one in a smooth spectrum has by chance: the mean of n unit exponentials, less one; of bursts odds; of
  a whole error how many times the sensor's noise it is.
  """
  if item.count == 0:
    return 0.0
  if item.comparison is not None:
    by_chance = float(student.sf(item.comparison.t, max(len(item.comparison.blocks) - 1, 1)))
    return (item.size / levels.material) ** 2 if by_chance < levels.chance else 0.0
  if item.line is not None:
    return item.nats / (float(gamma.isf(levels.rhythm, item.count)) / item.count - 1.0)
  level = levels.error if item.family == "error" else levels.bursts
  return item.nats / level if item.size >= levels.material else 0.0


def above_level(found: Sequence[Leftover], levels: Levels) -> tuple[Leftover, ...]:
  """Leftovers that are some, strongest first, but whole errors, of which nothing else is known, last."""
  order = lambda i: (i.family == "error", -strength(i, levels))
  return tuple(sorted((i for i in found if strength(i, levels) >= 1.0), key=order))


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


def errors_left(fits: Mapping[str, ChannelFit], pool: Pool) -> tuple[list[Leftover], list[Leftover]]:
  """What two twins get wrong on recordings that were not fitted, before and after, of channels measured directly.

  An error need not follow anything that is looked at. Displacements are not asked: one slide of the car decides them.
  """
  observations = pool.problem.observations
  before, after = [], []
  for channel, fit in fits.items():
    noise = max(fit.noise_floor, fit.driving_noise)
    if RESIDUALS[channel].displacement is not None or channel not in observations.present or noise <= 0.0:
      continue
    spread = float(np.std(observations.measured[observations.select(channel)]))
    for error, out in ((fit.before, before), (fit.after, after)):
      size = float(np.sqrt(max(error**2 - noise**2, 0.0))) / max(spread, 1e-12)
      follows = ("it need not follow anything",)
      out.append(Leftover(channel, "error", follows, error / noise, count=fit.samples, size=size))
  return before, after


def _share_left(before: Sequence[Leftover], rest: Sequence[Leftover], levels: Levels) -> float:
  left = max(strength(i, levels) for i in rest)
  return left / max(left, *(strength(i, levels) for i in before), 0.0)
