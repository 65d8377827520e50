"""The decision: what may be claimed by name.

Of the sets that fit best, one name first and one more at a time, that is claimed in which every name is more likely
right than wrong, see `weighing`. Held-out recordings, once opened for a set, tell how likely its names are, and not
which set is likelier. Whether something nameless remains is `conclude`'s question.
"""

import dataclasses
import math
from collections.abc import Sequence

from calibration.diagnosis.decision.claims import Claim, claim, seen, sensor_claims
from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.departures import Departure, departures, needed
from calibration.diagnosis.decision.evidence import Evidence, Model
from calibration.diagnosis.decision.levels import Levels, usual_levels
from calibration.diagnosis.decision.structure import Leftover
from calibration.diagnosis.decision.weighing import probability


@dataclasses.dataclass(frozen=True)
class Decision:
  """What may be said.

  Attributes:
    verdict: no_mismatch, explained, partly_explained or unexplained.
    claims: strongest first.
    possible: mechanisms likely enough alone, were it not for what a claim asks beside its probability.
    mechanisms: of the model behind the claims, sorted; () for the recalibrated twin.
    unknown: name of the UNKNOWN rival that did best, and its held-out comparison with the base.
    ranking: every mechanism tried with its evidence, best first.
    leftovers: structure the model behind the claims leaves beyond what recordings without effects show, strongest
      first.
    undecided: names that are alike and share what none of them has; "" otherwise. Where nothing is left over it is not
      said: what several names explain by chance is nothing.
    departures: figures of the car that the driving contradicts.
    nearest: the likeliest name where none is claimed and none are alike, with its probability; "" otherwise.
  """

  verdict: str
  claims: tuple[Claim, ...]
  possible: tuple[str, ...]
  mechanisms: tuple[str, ...]
  unknown: tuple[str, Comparison] | None
  ranking: tuple[tuple[str, float], ...]
  leftovers: tuple[Leftover, ...] = ()
  undecided: str = ""
  departures: tuple[Departure, ...] = ()
  nearest: str = ""

  @property
  def nameless(self) -> bool:
    """Whether something remains that no name explains."""
    return self.verdict in ("unexplained", "partly_explained")


def decide(evidence: Evidence, levels: Levels | None = None) -> Decision:
  """Weigh the models; the verdict is provisional until `conclude` has looked at what is left.

  Nothing is simulated or fitted, and the order of models and names in the evidence does not matter.

  Args:
    evidence: of all fitted models.
    levels: what decides; those of levels.toml by default.
  """
  levels = levels or usual_levels()
  best, names = evidence.base, []
  for size in range(1, max(len(m.mechanisms) for m in evidence.models) + 1):
    best, names = _likeliest(evidence, size, best, levels) or (best, names)
  claims = sorted([*sensor_claims(best, evidence, levels), *names], key=lambda c: (-c.evidence_nats, c.mechanism))
  undecided = "" if claims else _undecided(evidence, levels)
  verdict = "explained" if claims else "no_mismatch"
  possible, ranking = _possible(evidence, claims, levels), _ranking(evidence, claims)
  nearest = "" if claims or undecided else _nearest(evidence, levels)
  apart = tuple(d for d in departures(best.measured, levels) if needed(d, best, levels))
  return Decision(verdict, tuple(claims), possible, best.mechanisms, None, ranking, (), undecided, apart, nearest)


def _likeliest(evidence: Evidence, size: int, best: Model, levels: Levels) -> tuple[Model, list[Claim]] | None:
  """Of the sets of a size in which every name is likely enough, and which go beyond a smaller one, the likeliest."""
  found = []
  for model in evidence.of_size(size):
    weighed = [claim(name, model, evidence, levels) for name in model.names]
    names = [seen(c, model, evidence, levels) for c in weighed]
    enough = min(c.probability for c in (*weighed, *names)) >= levels.claim
    if enough and _goes_beyond(model, best, levels):
      found.append((math.prod(c.probability for c in weighed), model, names))
  return max(found, key=lambda f: f[0])[1:] if found else None


def _goes_beyond(model: Model, best: Model, levels: Levels) -> bool:
  """Whether a set is likely against a smaller one it does not hold, too: two names may imitate a third together."""
  if set(best.mechanisms) < set(model.mechanisms):
    return True
  other = next(a for a in model.against if a.mechanisms == best.mechanisms)
  likely = lambda n: levels.probability(min(other.t, n.t), min(other.drop, n.margin()))
  return all(likely(name) >= levels.claim for name in model.names)


def _undecided(evidence: Evidence, levels: Levels) -> str:
  """What to say, should the verdict be that something acts, where names that are alike share what none has; "" else."""
  likely = [c for c in _singles(evidence, levels) if c.shared >= levels.claim]
  names = dict.fromkeys(n for c in likely for n in (c.mechanism, *c.indistinguishable_from))
  return f"The nearest names are {', '.join(names)}; none of them is likely enough." if names else ""


def _nearest(evidence: Evidence, levels: Levels) -> str:
  """The likeliest name alone and what it falls short of; "" where none has any probability."""
  best = max(_singles(evidence, levels), key=lambda c: c.probability, default=None)
  if best is None or best.probability == 0.0:
    return ""
  ratio = evidence.held_out_ratio((best.mechanism,), best.mechanism) or 1.0
  share = f"{ratio - 1.0:.1%}".replace("%", " %")
  worse = f" With it the error on held-out recordings is {share} larger." if ratio > 1.0 else ""
  return (
    f"The likeliest name is {best.mechanism}, with a probability of {best.probability:.2f} where {levels.claim:g} is"
    f" needed.{worse}"
  )


def _singles(evidence: Evidence, levels: Levels) -> list[Claim]:
  each = ((name, model) for model in evidence.of_size(1) for name in model.names)
  return [seen(claim(name, model, evidence, levels), model, evidence, levels) for name, model in each]


def _possible(evidence: Evidence, claims: Sequence[Claim], levels: Levels) -> tuple[str, ...]:
  """Mechanisms likely enough alone and not claimed: at a bound, too small to matter, perhaps chance, shared."""
  named = {c.mechanism for c in claims}
  singles = [name for model in evidence.of_size(1) for name in model.names if name.name not in named]
  opened = lambda name: evidence.held_out_ratio((name,), name)
  likely = lambda n: levels.after_holdout(probability(n, levels), opened(n.name))
  return tuple(n.name for n in singles if likely(n) >= levels.claim)


def _ranking(evidence: Evidence, claims: Sequence[Claim]) -> tuple[tuple[str, float], ...]:
  """Claims first, then every mechanism that was refitted, by what it brings alone."""
  singles = {s.name: s.refitted for s in evidence.scanned if s.refitted is not None}
  order = sorted(singles.items(), key=lambda item: (-item[1], item[0]))
  named = {c.mechanism: c.evidence_nats for c in claims}
  return tuple(named.items()) + tuple((n, g) for n, g in order if n not in named)
