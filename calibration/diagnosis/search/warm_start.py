"""Ways back between minima: what was found with a mechanism is offered to models without it, and the reverse.

The cost has several minima. A search that compares a model at one with a model at another compares places, not physics.
"""

import itertools
import math
from collections.abc import Sequence

from calibration.diagnosis.candidates import HELD, Candidate, begin, candidate, promise, refine
from calibration.diagnosis.pool import Pool
from calibration.fitting.tolerances import exchanged

LIKELY = 5  # best sets of each size that are tried from elsewhere, too
_RETURNING = 4  # Gauss-Newton steps for a set from where another had ended
_LEADING = 4  # steps with fresh columns for a model of an earlier search
# nats by which a model must be expected lower to be fitted again, and must come down for its relatives to follow
_LOWER = 5.0
_ROUNDS = 3
_PRIORS = 1.0  # nats that priors must gain by an exchange: what a fit is sought to


def level(pool: Pool, best: Candidate) -> float:
  """Fit the foremost sets from where those that hold them, or are held by them, had ended, until none comes down.

  The cost has several minima. One that was only reached with a mechanism in the model may not need it, and one that was
  reached without it may hold with it: costs tell of mechanisms only where all sets had both offered.

  Args:
    pool: all fitted models, which may be replaced.
    best: the model of which all smaller sets take part, whatever they bring.

  Returns:
    by how many nats the base came down.
  """
  before = pool.base.cost
  offered: dict[tuple[frozenset[str], frozenset[str]], float] = {}  # set and giver: the giver's cost then
  for _ in range(_ROUNDS):
    stood = {key: model.cost for key, model in pool.models.items()}
    # pairs of a set and one that holds it or that it holds, whose estimates it may begin at
    pairs = [(a, b) for a, b in itertools.permutations(_taking_part(pool, best), 2) if a < b or b < a]
    givers = [pair for pair in pairs if pair[1] in stood]
    fresh = [pair for pair in givers if offered.get(pair, math.inf) - stood[pair[1]] >= _LOWER]
    offered |= {pair: stood[pair[1]] for pair in fresh}
    chosen = _expected_lower(pool, [_offer(pool, *pair) for pair in fresh])
    refine(pool.problem, chosen, _RETURNING)
    for model in chosen:
      pool.offer(model)
    pool.nest()
    if all(cost - pool.models[key].cost < _LOWER for key, cost in stood.items()):
      break
  return before - pool.base.cost


def exchange(pool: Pool, best: Candidate) -> None:
  """Fit the best set and those that it holds with commands late in place of all sensors, or the other way round, too.

  The recalibrated twin may have split a delay as it could with what it lacked; every set goes on from where it ended.
  """
  made = []
  for model in filter(None, map(pool.models.get, _held_by(best))):
    start = exchanged(model.free, model.values, _PRIORS)
    if start is not None:
      made.append(candidate(pool.problem, model.mechanisms, model, pool.priors, model.free.named(start)))
  begin(pool.problem, made)
  refine(pool.problem, made, _LEADING, full=True)
  for model in made:
    pool.offer(model)


def _taking_part(pool: Pool, best: Candidate) -> list[frozenset[str]]:
  """The best sets of each size, and all that the very best holds, itself among them."""
  keys = _held_by(best)
  for size in sorted({len(key) for key in pool.models}):
    keys += [frozenset(m.mechanisms) for m in pool.foremost(size, LIKELY)]
  return list(dict.fromkeys(keys))


def _held_by(model: Candidate) -> list[frozenset[str]]:
  """All sets of mechanisms that a model holds, from none to its own."""
  names = sorted(model.mechanisms)
  return [frozenset(some) for size in range(len(names) + 1) for some in itertools.combinations(names, size)]


def _offer(pool: Pool, key: frozenset[str], other: frozenset[str]) -> Candidate:
  """A model of a set from the estimates of another; what that lacks it has of its own."""
  own, giver = pool.models.get(key), pool.models[other]
  if own is None:
    return candidate(pool.problem, sorted(key), giver, pool.priors)
  lacking = {name: i for i, name in enumerate(own.free.names) if name not in giver.free}
  start = {name: float(own.values[i]) for name, i in lacking.items()}
  model = candidate(pool.problem, own.mechanisms, giver, pool.priors, start)
  for i in lacking.values():
    model.jacobian[:, i] = own.jacobian[:, i]
  return model


def _expected_lower(pool: Pool, models: Sequence[Candidate]) -> list[Candidate]:
  """Of the models of each set the one that a step should take lowest, where that is lower than what there is."""
  begin(pool.problem, models)
  lowest = {key: model.cost - _LOWER for key, model in pool.models.items()}
  chosen: dict[frozenset[str], Candidate] = {}
  for model in models:
    key, expected = frozenset(model.mechanisms), model.cost - promise(model, HELD)
    if expected < lowest.get(key, math.inf):
      lowest[key], chosen[key] = expected, model
  return list(chosen.values())


def warm_start(pool: Pool, models: Sequence[Candidate]) -> None:
  """Fit models of an earlier search on from where they had ended.

  What showed the way to a lower minimum of the recalibrated twin may be the effect all the same: seen from there, its
  signature may be so bent that no refit from the scan finds it again.

  Args:
    pool: all fitted models; those of the same sets may be replaced.
    models: fitted with other weights or from another minimum.
  """
  made = [
    candidate(pool.problem, m.mechanisms, pool.base, pool.priors, m.free.named(m.values))
    for m in models
    if m.mechanisms
  ]
  begin(pool.problem, made)
  refine(pool.problem, made, _LEADING, full=True)
  for model in made:
    pool.offer(model)
