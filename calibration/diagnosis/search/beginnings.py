"""Where sets of mechanisms begin to be fitted: at each smaller set, with the new one as the scan saw it.

Far from the base the scan may bend, and so may the way in which the base would meet an effect: of a few starts at a
smaller set the best is fitted. Which smaller set leads lowest no start tells. What one name has bent another may need
straight, and a set that lacks what the other explains begins higher, however low it ends.
"""

import dataclasses
from collections.abc import Sequence

from calibration.diagnosis.candidates import Candidate, begin, candidate, started
from calibration.diagnosis.pool import Pool

# shares of the scanned size a refit may start from, with the base moved to meet it or as it is
_STARTS = ((0.3, True), (1.0, True), (1.0, False))
_APART = 20.0  # nats that a smaller set must bring to be begun at beside the best: others are where the base is


@dataclasses.dataclass(frozen=True)
class Begun:
  """A simulated model of a set, `key`, that begins at a smaller set, `parent`.

  Where another smaller set fits better the two are `apart`, and columns taken elsewhere lead nowhere.
  """

  key: frozenset[str]
  parent: Candidate
  model: Candidate
  apart: bool


def begin_sets(pool: Pool, sets: Sequence[frozenset[str]]) -> list[Begun]:
  """Models of sets, one for each smaller set that is worth beginning at."""
  trials: list[tuple[frozenset[str], Candidate, list[Candidate], bool]] = []
  for key in sets:
    best, *others = _parents(pool, key)
    for parent in (best, *others):
      new, model = sorted(key - set(parent.mechanisms)), candidate(pool.problem, sorted(key), parent, pool.priors)
      starts = [_start(pool, parent, new, share, meet) for share, meet in _STARTS]
      begun = [started(pool.problem, model, start) for start in starts]
      trials.append((key, parent, begun, parent is not best))
  begin(pool.problem, [model for _, _, begun, _ in trials for model in begun])
  return [Begun(key, parent, min(begun, key=lambda m: m.cost), apart) for key, parent, begun, apart in trials]


def _parents(pool: Pool, key: frozenset[str]) -> list[Candidate]:
  """The fitted sets that are one smaller: first the best, then those that bring something by themselves."""
  smaller = [pool.models[k] for name in sorted(key) if (k := key - {name}) in pool.models] or [pool.best_subset(key)]
  best, *others = sorted(smaller, key=lambda m: m.cost)
  return [best, *(m for m in others if pool.base.cost - m.cost > _APART)]


def _start(pool: Pool, parent: Candidate, new: Sequence[str], share: float, meet: bool) -> dict[str, float]:
  """First values: the new mechanisms at a share of what was scanned, and the base moved to `meet` them."""
  start: dict[str, float] = {}
  for name in new:
    signature = pool.signatures.get(name)
    if signature is None:
      continue
    for parameter, move in signature.answer.items() if meet else ():
      here = float(parent.values[parent.free.index(parameter)])
      start[parameter] = start.get(parameter, here) + share * move
    for p in pool.problem.mechanism(name).parameters:
      if p.name in signature.start:
        value = signature.start[p.name]
        start[p.name] = value if p.null is None else p.null + share * (value - p.null)
  return start
