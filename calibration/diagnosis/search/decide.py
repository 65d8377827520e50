"""The decision: what may be claimed by name.

A mechanism is claimed only if leaving it out of the best set costs held-out evidence beyond what
recordings without any effect give by chance (significant), and if its size matters (material).
Rivals that fit as well are named with it. Whether something nameless remains is `conclude`'s question.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, compare, compare_freely, spoils, validation_ratio
from calibration.diagnosis.search.claims import Claim, bias_claims, claim
from calibration.diagnosis.search.structure import ensure
from calibration.diagnosis.search.thresholds import Thresholds, material, significant, strength, stretched
from calibration.diagnosis.unexplained.leftover import Leftover
from calibration.fitting.observations import CHANNELS


@dataclasses.dataclass(frozen=True)
class Decision:
  """What may be said.

  Attributes:
    verdict: no_mismatch, explained, partly_explained or unexplained.
    claims: strongest first.
    possible: mechanisms that were significant but not material, or the other way round.
    model: the model behind the claims; the recalibrated twin if there are none.
    unknown: name of the UNKNOWN rival that did best, and its held-out comparison with the base.
    ranking: every mechanism tried with its evidence, best first.
    leftovers: structure the model behind the claims leaves beyond what recordings without effects show, strongest
      first.
    alarm: what the loudest detector says where nothing else does, or what the model still misses; "" otherwise.
  """

  verdict: str
  claims: tuple[Claim, ...]
  possible: tuple[str, ...]
  model: Candidate
  unknown: tuple[str, Comparison] | None
  ranking: tuple[tuple[str, float], ...]
  leftovers: tuple[Leftover, ...] = ()
  alarm: str = ""


def decide(pool: Pool, thresholds: Thresholds = Thresholds()) -> Decision:
  """Weigh the pool's named models; the verdict is provisional until `conclude` has looked at what is left.

  Args:
    pool: all fitted models.
    thresholds: what a claim needs.
  """
  best = _needed(pool, _grown(pool, thresholds), thresholds)
  names = _names(pool, best, thresholds)
  best = _likely(pool, best, thresholds)
  claims = bias_claims(pool, best, thresholds) + _names(pool, best, thresholds)
  claims = sorted((c for c in claims if c.probability >= thresholds.probability), key=lambda c: -c.evidence_nats)
  alarm = "" if claims else _undecided([c for c in names if c.held_out.t >= thresholds.sure])
  verdict = "explained" if claims else "unexplained" if alarm else "no_mismatch"
  possible, ranking = _possible(pool, claims, thresholds), _ranking(pool, claims)
  return Decision(verdict, tuple(claims), possible, best, None, ranking, alarm=alarm)


def _names(pool: Pool, model: Candidate, thresholds: Thresholds) -> list[Claim]:
  """Every name of a model, weighed."""
  ensure(pool, [frozenset(model.mechanisms) - {name} for name in model.mechanisms])
  return [claim(pool, model, name, thresholds) for name in model.mechanisms]


def _needed(pool: Pool, model: Candidate, thresholds: Thresholds) -> Candidate:
  """What is left of a set without the names that it does not need, or that do harm where nothing was fitted."""
  return _useful(pool, _simplified(pool, model, thresholds), thresholds)


def _likely(pool: Pool, best: Candidate, thresholds: Thresholds) -> Candidate:
  """The best of a set and the smaller ones inside it, largest first, in which every name is likely enough.

  In a smaller one each name must be needed and matter again: what was found beside a name that is not claimed may have
  been what its formula leaves over.
  """
  for size in range(len(best.mechanisms), 0, -1):
    sets = [frozenset(names) for names in itertools.combinations(best.mechanisms, size)]
    ensure(pool, sets)
    found = [
      m
      for m in (pool.models[s] for s in sets)
      if (m is best or _stands(pool, m, thresholds))
      and all(c.probability >= thresholds.probability for c in _names(pool, m, thresholds))
    ]
    if found:
      return min(found, key=lambda m: m.cost)
  return pool.base


def _stands(pool: Pool, model: Candidate, thresholds: Thresholds) -> bool:
  """Whether a set needs each of its names, and each matters."""
  matter = all(material(pool, model, name, thresholds.material) for name in model.mechanisms)
  return matter and _needed(pool, model, thresholds) is model


def _undecided(sure: Sequence[Claim]) -> str:
  """What to say where something acts beyond doubt and no name is likely enough; "" where nothing does."""
  names = dict.fromkeys(n for c in sure for n in (c.mechanism, *c.equivalent_to))
  return f"The nearest names are {', '.join(names)}; none of them is likely enough." if names else ""


def _grown(pool: Pool, thresholds: Thresholds) -> Candidate:
  """The best set, size by size: each must beat the best smaller one significantly, and every member must matter."""
  best, observations = pool.base, pool.problem.observations
  for size in (1, 2, 3):
    needed = thresholds.beside_others() if size > 1 else thresholds
    better = [
      m for m in pool.of_size(size) if _passes(pool, m, compare(m, best, observations), needed, best.mechanisms)
    ]
    found = _foremost(pool, better, best)
    if best.mechanisms and not _worth_adding(pool, found, best, thresholds):
      return best
    best = found
  return best


def _foremost(pool: Pool, models: Sequence[Candidate], before: Candidate) -> Candidate:
  """The model that fits best, or the one that held-out evidence prefers to it.

  One with more parameters fits better what it was fitted to, and may foretell the rest worse. Neither holds the other,
  so all parameters of both are fitted to the other groups.
  """
  first = min(models, key=lambda m: m.cost, default=before)
  ahead = lambda m: 0.0 if m is first else compare_freely(first, m, pool.problem.observations).gain
  return min(models, key=ahead, default=before)


def _passes(pool: Pool, model: Candidate, test: Comparison, thresholds: Thresholds, before: Sequence[str] = ()) -> bool:
  """Whether a model is significant and all it names matters; what joins others may not be stretched to its bound.

  Names that were found `before` need not matter more beside others than they had to alone: it is what comes on top that
  may be no more than what their formulas leave over. Nor does one that is stretched keep a right one from joining it.
  """
  alone = len(model.mechanisms) == 1
  share = {n: thresholds.material if alone or n in before else thresholds.further for n in model.mechanisms}
  if not all(material(pool, model, name, share[name]) for name in model.mechanisms):
    return False
  joined = () if alone else [n for n in model.mechanisms if n not in before]
  return significant(test, thresholds) and not any(stretched(pool, model, n) for n in joined)


def _worth_adding(pool: Pool, found: Candidate, best: Candidate, thresholds: Thresholds) -> bool:
  """Whether a further mechanism is more than what a formula right in kind leaves for others to pick up."""
  share = (best.cost - found.cost) / max(pool.base.cost - best.cost, 1e-9)
  if share >= thresholds.beside or _share_where_it_shows(pool, found, best) >= thresholds.beside:
    return True
  new = set(found.mechanisms) - set(best.mechanisms)
  reaches = lambda size: all(material(pool, found, name, size) for name in new)
  if share >= thresholds.trace and reaches(thresholds.plain):
    return True
  return compare(found, best, pool.problem.observations).relative >= thresholds.rest and reaches(thresholds.full)


def _share_where_it_shows(pool: Pool, found: Candidate, best: Candidate) -> float:
  """What a larger set brings in the channels that hold four fifths of it, over what the smaller one brought there.

  A formula that is not right in every detail leaves something over where it acts. An effect in other channels is
  another one, however small it is beside a strong first.
  """
  fitted, channel = found.n_train, pool.problem.observations.channel[: found.n_train]
  power = lambda m: 0.5 * np.bincount(channel, m.residual[:fitted] ** 2, minlength=len(CHANNELS))
  new, old = power(best) - power(found), power(pool.base) - power(best)
  order = np.argsort(-new)
  brought = np.cumsum(np.maximum(new[order], 0.0))
  shows = order[: 1 + int(np.searchsorted(brought, 0.8 * brought[-1]))]
  return float(new[shows].sum() / max(old[shows].sum(), 1e-9))


def _possible(pool: Pool, claims: list[Claim], thresholds: Thresholds) -> tuple[str, ...]:
  """Mechanisms that alone are significant but too small to matter, and not claimed."""
  named = {c.mechanism for c in claims}
  return tuple(
    model.mechanisms[0]
    for model in sorted(pool.of_size(1), key=lambda m: m.cost)
    if model.mechanisms[0] not in named
    and significant(test := compare(model, pool.base, pool.problem.observations), thresholds)
    and not _passes(pool, model, test, thresholds)
  )


def _simplified(pool: Pool, best: Candidate, thresholds: Thresholds) -> Candidate:
  """Drop what the best set does not need, weakest first."""
  while best.mechanisms:
    ensure(pool, [frozenset(best.mechanisms) - {name} for name in best.mechanisms])
    tests = {
      n: compare(best, pool.models[frozenset(best.mechanisms) - {n}], pool.problem.observations)
      for n in best.mechanisms
    }
    needed = thresholds.beside_others() if len(tests) > 1 else thresholds
    weakest = min(tests, key=lambda n: strength(tests[n], needed))
    if significant(tests[weakest], needed):
      return best
    best = pool.models[frozenset(best.mechanisms) - {weakest}]
  return best


def _useful(pool: Pool, best: Candidate, thresholds: Thresholds) -> Candidate:
  """Drop names by which recordings that only judge are predicted worse than by the recalibrated twin.

  Three kinds are not dropped: one that frees what was measured from what it was bent to, since what it replaced had
  imitated it well; one that explains much of all that is missed, beside which something else still acts; and one whose
  evidence, in which these recordings were counted, is beyond doubt. But nothing excuses a channel that is spoiled: what
  takes error from one channel and multiplies that of another is no repair, whatever it explains; unless what is lost is
  no more beside what is won than a formula leaves that is right in kind but not in every detail.
  """
  observations = pool.problem.observations
  error = lambda m: validation_ratio(m, pool.base, observations)
  spoiled = lambda m: spoils(m, pool.base, observations, thresholds.spoiled, thresholds.beside)
  while best.mechanisms and (error(best) > thresholds.worse or spoiled(best)):
    keys = [frozenset(best.mechanisms) - {name} for name in best.mechanisms]
    ensure(pool, keys)
    tests = [(compare(best, pool.models[key], observations), pool.models[key]) for key in keys]
    excused = lambda t: t.priors >= thresholds.priors or t.relative >= thresholds.much or t.t >= thresholds.sure
    smaller = [m for t, m in tests if spoiled(best) or not excused(t)]
    if not smaller:
      return best
    best = min(smaller, key=error)
  return best


def _ranking(pool: Pool, claims: list[Claim]) -> tuple[tuple[str, float], ...]:
  """Claims first, then every mechanism by what it brings alone: refitted where it was, else as scanned."""
  singles = {m.mechanisms[0]: pool.base.cost - m.cost for m in pool.of_size(1)}
  least = min(singles.values(), default=0.0)
  scanned = {n: min(s.gain, least) for n, s in pool.signatures.items() if n not in singles}
  order = sorted((singles | scanned).items(), key=lambda kv: -kv[1])
  named = {c.mechanism: c.evidence_nats for c in claims}
  return tuple(named.items()) + tuple((n, g) for n, g in order if n not in named)
