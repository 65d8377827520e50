"""S6, the decision: what may be claimed by name.

A mechanism is claimed only if leaving it out of the best set costs held-out evidence beyond what
recordings without any effect give by chance (significant), and if its size matters (material).
Rivals that fit as well are named with it. Whether something nameless remains is `conclude`'s question.
"""

import dataclasses
import math

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.leftover import Leftover
from calibration.diagnosis.recalibrate import BIAS_MECHANISMS
from calibration.diagnosis.score import Comparison, clustered_std, compare, evidence, judged
from calibration.diagnosis.search import Pool, ensure
from calibration.observations import CHANNELS
from qcar_twin.parameters import ParameterSet

_LOST = 0.25  # of what the priors bring, that held-out evidence may take away again
# of a value, by which a formula right in kind but not in every detail misses; by hand, development cases missed by 0.01 to 0.28
_FORM = 0.12


@dataclasses.dataclass(frozen=True)
class Thresholds:
  """What a claim needs; set by hand on about sixty development sessions of the proving ground.

  What sessions without any effect reach is listed on a campaign's page: apart from what recalibration is allowed to
  absorb (TOLERANCES), mechanisms of material size stayed below t = 2.2 and 42 nats on 20 of them.

  Attributes:
    t: held-out gain over its standard error.
    nats: held-out gain.
    many, t_many: more nats than chance brings will do with a smaller t: an effect that acts now and then scatters.
    much, t_much: with a share of all that is missed that chance never explains (0.03), the same with a smaller t still:
      a formula that is wrong in shape makes some blocks worse, and what it brings the others is capped.
    share: groups that gained.
    priors: nats by which a mechanism must free measured parameters from what they were bent to, where recalibration
      leaves no residual of it.
    material: share of the typical size: the twin's own simplifications look like a tenth of some effects, however clearly.
    further: the same for a mechanism beside others, for which `many` nats don't help, either: a first formula that is
      right in kind but not in every detail leaves small things over.
    bias: the same for biases of the IMU and the encoder's lag, of which every one has some.
    beside: share of the cost explained so far, at all or in the channels where it shows, that a further mechanism
      must bring: a formula that is right in kind but not in every detail leaves about that much for others to pick up.
    trace, plain: a smaller share will do, but at least `trace`, for a mechanism of at least `plain` typical sizes.
    probability: a name less likely right than this is not claimed.
    worse: a set of names by which recordings that only judge are predicted worse by this factor is cut down.
    equivalent: a rival within so many standard errors of the claim can't be told apart.
  """

  t: float = 2.4
  nats: float = 20.0
  many: float = 45.0
  t_many: float = 1.8
  much: float = 0.1
  t_much: float = 1.2
  share: float = 0.55
  priors: float = 60.0
  material: float = 0.15
  further: float = 0.25
  bias: float = 0.55
  beside: float = 0.05
  trace: float = 0.01
  plain: float = 0.4
  probability: float = 0.4
  worse: float = 1.01
  equivalent: float = 1.0

  def beside_others(self) -> "Thresholds":
    """What a mechanism beside others needs."""
    return dataclasses.replace(self, many=np.inf, material=max(self.material, self.further))


@dataclasses.dataclass(frozen=True)
class Claim:
  """One mechanism that is held responsible."""

  mechanism: str
  probability: float
  evidence_nats: float
  held_out: Comparison
  parameters: dict[str, dict[str, float | str]]
  rivals: tuple[tuple[str, float], ...]
  equivalent_to: tuple[str, ...]
  certain: bool


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
    leftovers: structure the model behind the claims leaves beyond what recordings without effects show, strongest first.
    alarm: what the loudest detector says where nothing else does; "" otherwise.
  """

  verdict: str
  claims: tuple[Claim, ...]
  possible: tuple[str, ...]
  model: Candidate
  unknown: tuple[str, Comparison] | None
  ranking: tuple[tuple[str, float], ...]
  leftovers: tuple[Leftover, ...] = ()
  alarm: str = ""


def decide(pool: Pool, thresholds: Thresholds = Thresholds()) -> Decision:  # noqa: B008 - frozen
  """Weigh the pool's named models; the verdict is provisional until `conclude` has looked at what is left.

  Args:
    pool: all fitted models.
    thresholds: what a claim needs.
  """
  best = _useful(pool, _simplified(pool, _grown(pool, thresholds), thresholds), thresholds)
  claims = _bias_claims(pool, best, thresholds) + [_claim(pool, best, name, thresholds) for name in best.mechanisms]
  claims = [c for c in claims if c.probability >= thresholds.probability]
  kept = frozenset(c.mechanism for c in claims) - set(BIAS_MECHANISMS)
  ensure(pool, [kept])
  best = pool.models[kept]
  claims.sort(key=lambda c: -c.evidence_nats)
  verdict = "explained" if claims else "no_mismatch"
  return Decision(verdict, tuple(claims), _possible(pool, claims, thresholds), best, None, _ranking(pool, claims))


def _grown(pool: Pool, thresholds: Thresholds) -> Candidate:
  """The best set, size by size: each must beat the best smaller one significantly, and every member must matter."""
  best, observations = pool.base, pool.problem.observations
  for size in (1, 2, 3):
    needed = thresholds.beside_others() if size > 1 else thresholds
    better = [m for m in pool.of_size(size) if _passes(pool, m, compare(m, best, observations), needed)]
    found = min(better, key=lambda m: m.cost, default=best)
    if best.mechanisms and not _worth_adding(pool, found, best, thresholds):
      return best
    best = found
  return best


def _passes(pool: Pool, model: Candidate, test: Comparison, thresholds: Thresholds) -> bool:
  """Whether a model is significant and all it names matters."""
  material = (_material(pool, model, name, thresholds.material) for name in model.mechanisms)
  return _significant(test, thresholds) and all(material)


def _worth_adding(pool: Pool, found: Candidate, best: Candidate, thresholds: Thresholds) -> bool:
  """Whether a further mechanism is more than what a formula right in kind leaves for others to pick up."""
  share = (best.cost - found.cost) / max(pool.base.cost - best.cost, 1e-9)
  if share >= thresholds.beside or _share_where_it_shows(pool, found, best) >= thresholds.beside:
    return True
  new = set(found.mechanisms) - set(best.mechanisms)
  plain = all(_material(pool, found, name, thresholds.plain) for name in new)
  return plain and share >= thresholds.trace


def _share_where_it_shows(pool: Pool, found: Candidate, best: Candidate) -> float:
  """What a larger set brings in the channels that hold four fifths of it, over what the smaller one brought there.

  A formula that is not right in every detail leaves something over where it acts. An effect in other channels is
  another one, however small it is beside a strong first.
  """
  fitted, channel = found.fitted, pool.problem.observations.channel[: found.fitted]
  power = lambda m: 0.5 * np.bincount(channel, m.residual[:fitted] ** 2, minlength=len(CHANNELS))  # noqa: E731
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
    and _significant(test := compare(model, pool.base, pool.problem.observations), thresholds)
    and not _passes(pool, model, test, thresholds)
  )


def _bias_claims(pool: Pool, best: Candidate, thresholds: Thresholds) -> list[Claim]:
  """IMU biases far beyond what every IMU has; they are part of every model, so leaving them out is the test."""
  claims = []
  for name in sorted(set(BIAS_MECHANISMS) & {m.name for m in pool.problem.twin.mechanisms}):
    names = [p.name for p in pool.problem.mechanism(name).parameters if p.name in best.free]
    if not names or not _material(pool, best, name, thresholds.bias):
      continue
    without = _at_null(best, names)
    test = compare(best, without, pool.problem.observations)
    if _significant(test, thresholds):
      gain = evidence(best, without, pool.problem.observations)
      estimates = _estimates(pool, name, best)
      claims.append(Claim(name, _probability(test, gain), gain, test, estimates, (), (), True))
  return claims


def _at_null(model: Candidate, names: list[str]) -> Candidate:
  """A model with some parameters held at zero and the rest refitted, to first order."""
  held = [model.free.index(n) for n in names]
  rest = [i for i in range(len(model.free)) if i not in held]
  move = np.zeros(len(model.free))
  move[held] = -model.values[held]
  pull = model.gradient + model.curvature @ move
  scale = model.free.scale[rest]
  inner = model.curvature[np.ix_(rest, rest)] * np.outer(scale, scale)
  move[rest] = -np.linalg.lstsq(inner, pull[rest] * scale, rcond=None)[0] * scale
  return dataclasses.replace(
    model,
    free=ParameterSet(model.free[model.free.names[i]] for i in rest),
    values=(model.values + move)[rest],
    residual=model.residual + model.jacobian @ move,
    jacobian=model.jacobian[:, rest],
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
    weakest = min(tests, key=lambda n: _strength(tests[n], needed))
    if _significant(tests[weakest], needed):
      return best
    best = pool.models[frozenset(best.mechanisms) - {weakest}]
  return best


def _useful(pool: Pool, best: Candidate, thresholds: Thresholds) -> Candidate:
  """Drop names by which recordings that only judge are predicted worse than by the recalibrated twin.

  Two kinds are not dropped: one that frees what was measured from what it was bent to, since what it replaced had
  imitated it well, and one that explains much of all that is missed, beside which something else still acts.
  """
  observations = pool.problem.observations
  error = lambda m: judged(m, pool.base, observations)  # noqa: E731
  while best.mechanisms and error(best) > thresholds.worse:
    keys = [frozenset(best.mechanisms) - {name} for name in best.mechanisms]
    ensure(pool, keys)
    tests = [(compare(best, pool.models[key], observations), pool.models[key]) for key in keys]
    smaller = [m for t, m in tests if t.priors < thresholds.priors and t.relative < thresholds.much]
    if not smaller:
      return best
    best = min(smaller, key=error)
  return best


def _significant(test: Comparison, thresholds: Thresholds) -> bool:
  """By held-out evidence, or, where an effect is absorbed, by the parameters it lets go back to what was believed.

  One that predicts recordings left out much worse has freed them by imitating something else.
  """
  if test.priors >= thresholds.priors and test.total > -_LOST * test.priors:
    return True
  return _strength(test, thresholds) >= 1.0 and test.share_positive >= thresholds.share


def _strength(test: Comparison, thresholds: Thresholds) -> float:
  """Held-out evidence in units of what a claim needs."""
  usual = min(test.t / thresholds.t, test.gain / thresholds.nats)
  enough = max(test.t / thresholds.t_many, min(test.t / thresholds.t_much, test.relative / thresholds.much))
  return max(usual, min(enough, test.gain / thresholds.many))


def _claim(pool: Pool, best: Candidate, name: str, thresholds: Thresholds) -> Claim:
  without = pool.models[frozenset(best.mechanisms) - {name}]
  held_out = compare(best, without, pool.problem.observations)
  rivals, serious, equivalent = [], [0.0], []
  for key, model in pool.models.items():
    other = key - set(without.mechanisms)
    if len(key) == len(best.mechanisms) and set(without.mechanisms) < key and len(other) == 1 and name not in other:
      (rival,) = other
      rivals.append((rival, without.cost - model.cost))
      # one that would not be claimed itself (it frees priors and predicts worse) is no rival
      if _significant(compare(model, without, pool.problem.observations), thresholds):
        serious.append(without.cost - model.cost)
      gap = compare(best, model, pool.problem.observations)
      if gap.t < thresholds.equivalent or gap.gain < 0.03 * held_out.gain:
        equivalent.append(rival)
  rivals.sort(key=lambda r: -r[1])
  gain = without.cost - best.cost
  margin = gain - max(serious)
  return Claim(
    mechanism=name,
    probability=_probability(held_out, margin),
    evidence_nats=evidence(best, without, pool.problem.observations),
    held_out=held_out,
    parameters=_estimates(pool, name, best),
    rivals=tuple(rivals[:5]),
    equivalent_to=tuple(equivalent),
    certain=True,
  )


def _probability(held_out: Comparison, margin: float) -> float:
  """Probability that the name is right, from the margin over the next rival and the held-out t.

  A logistic in log margin and t with plausible numbers. It is not calibrated yet: that takes a campaign.
  """
  score = -1.2 + 0.75 * math.log1p(max(margin, 0.0) / 3.0) + 0.25 * (min(held_out.t, 8.0) - 3.0)
  return float(np.clip(1.0 / (1.0 + math.exp(-score)), 0.02, 0.99))


def _estimates(pool: Pool, name: str, model: Candidate) -> dict[str, dict[str, float | str]]:
  """Value, standard deviation and unit of a mechanism's parameters; the formula's own error is part of the deviation."""
  values = model.free.named(model.values)
  scatter = model.free.named(clustered_std(model, pool.problem.observations))
  found = [p for p in pool.problem.mechanism(name).parameters if p.name in model.free]
  form = {p.name: 0.0 if p.null is None else _FORM * abs(values[p.name] - p.null) for p in found}
  return {
    p.name: {"value": values[p.name], "std": float(np.hypot(scatter[p.name], form[p.name])), "unit": p.unit}
    for p in found
  }


def _material(pool: Pool, model: Candidate, name: str, share: float) -> bool:
  """Whether any amplitude of a mechanism reaches a share of its typical size, and its own uncertainty.

  That it is there at all is for the evidence to say: amplitudes of one mechanism may be known together and not singly.
  """
  for parameter in pool.problem.mechanism(name).parameters:
    if parameter.null is None or parameter.name not in model.free:
      continue
    value, std = model.estimate(parameter.name)
    size = abs(value - parameter.null)
    if size >= share * (parameter.typical or parameter.scale) and size >= std:
      return True
  return False


def _ranking(pool: Pool, claims: list[Claim]) -> tuple[tuple[str, float], ...]:
  """Claims first, then every mechanism by what it brings alone: refitted where it was, else as scanned."""
  singles = {m.mechanisms[0]: pool.base.cost - m.cost for m in pool.of_size(1)}
  least = min(singles.values(), default=0.0)
  scanned = {n: min(s.gain, least) for n, s in pool.signatures.items() if n not in singles}
  order = sorted((singles | scanned).items(), key=lambda kv: -kv[1])
  named = {c.mechanism: c.evidence_nats for c in claims}
  return tuple(named.items()) + tuple((n, g) for n, g in order if n not in named)
