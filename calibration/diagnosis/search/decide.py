"""The decision: what may be claimed by name.

Of the sets that fit best, one name first and one more at a time, that is claimed in which every name is more likely
right than wrong, see `weighing`. Whether something nameless remains is `conclude`'s question.
"""

import dataclasses
import math
from collections.abc import Sequence

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, compare
from calibration.diagnosis.search.claims import Claim, bias_claims, claim
from calibration.diagnosis.search.structure import ensure
from calibration.diagnosis.search.weighing import Levels, stretched, usual_levels, weighed
from calibration.diagnosis.unexplained.leftover import Leftover

LARGEST = 3  # names in a set
CONSIDERED = 4  # sets of each size, those that fit best


@dataclasses.dataclass(frozen=True)
class Decision:
  """What may be said.

  Attributes:
    verdict: no_mismatch, explained, partly_explained or unexplained.
    claims: strongest first.
    possible: mechanisms that would be claimed if they were larger.
    model: the model behind the claims; the recalibrated twin if there are none.
    unknown: name of the UNKNOWN rival that did best, and its held-out comparison with the base.
    ranking: every mechanism tried with its evidence, best first.
    leftovers: structure the model behind the claims leaves beyond what recordings without effects show, strongest
      first.
    undecided: names that are alike and share what none of them has; "" otherwise. Where nothing is left over it is not
      said: what several names explain by chance is nothing.
  """

  verdict: str
  claims: tuple[Claim, ...]
  possible: tuple[str, ...]
  model: Candidate
  unknown: tuple[str, Comparison] | None
  ranking: tuple[tuple[str, float], ...]
  leftovers: tuple[Leftover, ...] = ()
  undecided: str = ""


def decide(pool: Pool, levels: Levels | None = None) -> Decision:
  """Weigh the pool's named models; the verdict is provisional until `conclude` has looked at what is left.

  Args:
    pool: all fitted models.
    levels: what decides; those of levels.toml by default.
  """
  levels = levels or usual_levels()
  best, names = pool.base, []
  for size in range(1, LARGEST + 1):
    best, names = _likeliest(pool, size, best, levels) or (best, names)
  claims = sorted([*bias_claims(pool, best, levels), *names], key=lambda c: -c.evidence_nats)
  undecided = "" if claims else _undecided(pool, levels)
  verdict = "explained" if claims else "no_mismatch"
  possible, ranking = _possible(pool, claims, levels), _ranking(pool, claims)
  return Decision(verdict, tuple(claims), possible, best, None, ranking, undecided=undecided)


def foremost(pool: Pool, size: int) -> list[Candidate]:
  """The sets of a size that fit best, with what they are weighed against in the pool."""
  models = sorted(pool.of_size(size), key=lambda m: m.cost)[:CONSIDERED]
  ensure(pool, [frozenset(m.mechanisms) - {name} for m in models for name in m.mechanisms])
  return [pool.models[frozenset(m.mechanisms)] for m in models]


def figures(pool: Pool) -> list[dict[str, object]]:
  """What was weighed, name by name: what `qcar-twin set-levels` fits."""
  rows = []
  for model in (m for size in range(1, LARGEST + 1) for m in foremost(pool, size)):
    for name in model.mechanisms:
      found = weighed(pool, model, name)
      row = {"t": found.t, "size": found.size, "margin": found.margin(), "nats": found.drop}
      rows.append({"set": list(model.mechanisms), "name": name, "at_bound": stretched(pool, model, name)} | row)
  return rows


def _likeliest(pool: Pool, size: int, best: Candidate, levels: Levels) -> tuple[Candidate, list[Claim]] | None:
  """Of the sets of a size in which every name is likely enough, and which go beyond a smaller one, the likeliest."""
  found = []
  for model in foremost(pool, size):
    names = [claim(pool, model, name, levels) for name in model.mechanisms]
    if min(c.probability for c in names) >= levels.claim and _goes_beyond(pool, model, best, levels):
      found.append((math.prod(c.probability for c in names), model, names))
  return max(found, key=lambda f: f[0])[1:] if found else None


def _goes_beyond(pool: Pool, model: Candidate, best: Candidate, levels: Levels) -> bool:
  """Whether a set is likely against a smaller one it does not hold, too: two names may imitate a third together."""
  if set(best.mechanisms) < set(model.mechanisms):
    return True
  gain, ahead = compare(model, best, pool.problem.observations), best.cost - model.cost
  for found in (weighed(pool, model, name) for name in model.mechanisms):
    t, margin = min(gain.t_with_priors, found.t), min(ahead, found.margin())
    if levels.probability(t, found.size, margin) < levels.claim:
      return False
  return True


def _undecided(pool: Pool, levels: Levels) -> str:
  """What to say, should the verdict be that something acts, where names that are alike share what none has; "" else."""
  singles = [claim(pool, model, model.mechanisms[0], levels) for model in foremost(pool, 1)]
  likely = [c for c in singles if c.shared >= levels.claim]
  names = dict.fromkeys(n for c in likely for n in (c.mechanism, *c.indistinguishable_from))
  return f"The nearest names are {', '.join(names)}; none of them is likely enough." if names else ""


def _possible(pool: Pool, claims: Sequence[Claim], levels: Levels) -> tuple[str, ...]:
  """Mechanisms that would be claimed if they were of their typical size."""
  named = {c.mechanism for c in claims}
  singles = [(m.mechanisms[0], weighed(pool, m, m.mechanisms[0])) for m in foremost(pool, 1)]
  likely = lambda w: levels.probability(w.t, 1.0, w.margin()) >= levels.claim
  return tuple(name for name, found in singles if name not in named and likely(found))


def _ranking(pool: Pool, claims: Sequence[Claim]) -> tuple[tuple[str, float], ...]:
  """Claims first, then every mechanism by what it brings alone: refitted where it was, else as scanned."""
  singles = {m.mechanisms[0]: pool.base.cost - m.cost for m in pool.of_size(1)}
  least = min(singles.values(), default=0.0)
  scanned = {n: min(s.gain, least) for n, s in pool.signatures.items() if n not in singles}
  order = sorted((singles | scanned).items(), key=lambda kv: -kv[1])
  named = {c.mechanism: c.evidence_nats for c in claims}
  return tuple(named.items()) + tuple((n, g) for n, g in order if n not in named)
