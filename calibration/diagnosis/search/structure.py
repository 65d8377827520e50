"""Joint refit and structure search: sets of up to three mechanisms, add, drop and swap.

The scan nominates singles; signatures seen against the residuals of the best singles nominate
pairs (so that two effects which hide each other are found together); a third is added to the best
pairs only where a pair was worth it. Every set is refitted with all base parameters. A set never
fits worse than its own subsets: where a start leads there, the subset's estimates are taken over.
"""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from calibration.diagnosis.candidates import Candidate, begin, candidate, refine
from calibration.diagnosis.confirm import confirm, confirm_best
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.scan import Projector, Signature, explained
from calibration.diagnosis.score import compare
from calibration.diagnosis.search.beginnings import begin_sets
from calibration.diagnosis.search.multistart import multistart_models
from calibration.diagnosis.search.reweighting import reweight_if_worth_it
from calibration.diagnosis.search.warm_start import LIKELY, exchange, level, warm_start
from calibration.diagnosis.search.weighing import shown_size
from calibration.fitting.likelihood import Problem
from calibration.fitting.noise_floor import sensor_floor
from calibration.fitting.recalibration import RecalibratedTwin
from calibration.progress import Progress, silent

_HOPE = 10.0  # nats a model may still lie above its subset to be worth another step
_WORTH_A_SINGLE = 2.0  # nats a mechanism must promise in the scan before it is refitted
_WORTH_A_PAIR = 12.0  # nats a second one must promise before its pair is refitted; a claim takes more
_OVERSHADOWED = 0.8  # share of the base's cost below which the best single puts all others in the shade
_STRAYED = 50.0  # nats that the recalibrated twin may come down before nothing fitted from it counts any more
_DOUBTED = 0.1  # least part of a promise that is believed after a refit did not keep it
_PROMISED, _BROKEN = 50.0, 0.5  # nats a scan must have promised, and the part below which a refit broke the promise
_INSISTED, _PATIENCE = 2, 4  # mechanisms that are tried harder, and their steps with fresh columns of everything
_DONE = 5.0  # nats below which a step with fresh columns is not followed by another
_WORTH_A_RACE = 20.0  # nats of the best single below which it is left where it is
_NEAR, _RACING = 0.5, 3  # share of its gain from which on others race it, and how many take part in all
_TRIFLE = 0.15  # share of the typical size below which a mechanism can't be what many nats are due to


@dataclasses.dataclass(frozen=True)
class Effort:
  """How wide the search is: singles, pairs, triples that are refitted, Gauss-Newton steps, and whether a formula is
  sought for what has no name."""

  singles: int = 9
  pairs: int = 5
  triples: int = 3
  iterations: int = 3
  formula: bool = True


NARROW = Effort(singles=5, pairs=2, triples=1, iterations=1, formula=False)


def search(
  baseline: RecalibratedTwin,
  base: Candidate,
  signatures: dict[str, Signature],
  effort: Effort = Effort(),
  progress: Progress = silent,
  earlier: Sequence[Candidate] = (),
) -> Pool:
  """Fit the sets worth fitting.

  Args:
    baseline: the recalibrated twin.
    base: the same as a model of the pool, with its Jacobian.
    signatures: from the scan against it.
    effort: how wide to search.
    progress: reports what is being done.
    earlier: models of a search from another minimum, which are fitted on from where they had ended.

  Returns:
    all models; those fitted by then where the recalibrated twin turned out to have `base_not_converged`, which it
    is not asked again if there was an earlier search.
  """
  problem = baseline.problem
  pool = Pool(problem, baseline.fit.parameters, {frozenset(): base}, signatures, sensor_floor(baseline.noise_models))
  progress("refitting single mechanisms")
  _fit_sets(pool, [frozenset([n]) for n in _nominate_singles(problem, signatures, effort.singles)], effort.iterations)
  likely = [m.mechanisms[0] for m in pool.foremost(1, LIKELY)]
  seen = [name for name, signature in signatures.items() if signature.shown > 0.0]
  for model in multistart_models(problem, base, pool.priors, seen, likely):
    pool.offer(model)
  refine_stalled(pool)
  pool.kept = {m.mechanisms[0]: _kept(pool, m.mechanisms[0]) for m in pool.of_size(1)}
  warm_start(pool, earlier)
  best = pool.best(pool.of_size(1))
  if best is not pool.base and level(pool, best) > _STRAYED and not earlier:
    pool.base_not_converged = True
    return pool
  reweight_if_worth_it(pool, _leaders)
  refine_leaders(pool)
  progress("refitting pairs")
  _fit_sets(pool, _nominate_pairs(pool, effort.pairs), effort.iterations)
  if _worth_growing(pool):
    progress("refitting triples")
    _fit_sets(pool, _nominate_larger(pool, 2, 3)[: effort.triples], effort.iterations)
  progress("polishing the best model")
  best = pool.best(list(pool.models.values()))
  if best is not pool.base:
    exchange(pool, best)
    best = pool.best(list(pool.models.values()))
    _polish(pool, [best], _PATIENCE)
    lowered = level(pool, best)
    # with new weights the base was only brought near its minimum, and its cost is many times larger
    pool.base_not_converged = pool.problem is problem and lowered > _STRAYED
    _without_trifles(pool)
  confirm_best(pool)
  return pool


def ensure(pool: Pool, sets: Iterable[frozenset[str]]) -> None:
  """Fit sets that are not in the pool yet."""
  new = [s for s in sets if s not in pool.models]
  _fit_sets(pool, new, Effort.iterations)
  confirm(pool, closely=[pool.models[key] for key in new])


def _nominate_singles(problem: Problem, signatures: dict[str, Signature], count: int) -> list[str]:
  """The best of the scan, and those of which a scan's straight line tells little."""
  visible = [s for s in signatures.values() if s.testable and s.gain > _WORTH_A_SINGLE]
  best = [s.mechanism for s in sorted(visible, key=lambda s: -s.gain)[:count]]
  return best + [
    n for n, s in signatures.items() if s.testable and problem.mechanism(n).nonlinear_response and n not in best
  ]


def _nominate_pairs(pool: Pool, count: int) -> list[frozenset[str]]:
  """Partners of the best singles by what their signature explains of the single's residual, and those that bend."""
  return list(dict.fromkeys([*_nominate_larger(pool, 1, 6)[:count], *_bending_partners(pool)]))


def _nominate_larger(pool: Pool, size: int, parents: int) -> list[frozenset[str]]:
  """Sets one larger than the best of a size that promise enough and are not in the pool, best first."""
  gains: dict[frozenset[str], float] = {}
  for model in pool.foremost(size, parents):
    for name, gain in _explains(pool, model).items():
      key = frozenset([*model.mechanisms, name])
      if gain > _WORTH_A_PAIR and key not in pool.models:
        gains[key] = max(gains.get(key, -np.inf), gain - (model.cost - pool.base.cost))
  return sorted(gains, key=lambda k: -gains[k])


def _bending_partners(pool: Pool) -> list[frozenset[str]]:
  """The best single, where it stands beyond doubt, with each mechanism of which a scan's straight line tells little."""
  best = pool.best(pool.of_size(1))
  if best is pool.base or not _beyond_doubt(pool, best, pool.base):
    return []
  bending = (n for n, s in pool.signatures.items() if s.testable and pool.problem.mechanism(n).nonlinear_response)
  return [frozenset([*best.mechanisms, name]) for name in bending if name not in best.mechanisms]


def _explains(pool: Pool, model: Candidate) -> dict[str, float]:
  """Nats each further mechanism's signature would explain of a model's residual, to first order.

  A promise counts as much as the mechanism's own refit kept of what the scan had promised, and nothing where an
  amplitude without a sign would have to be negative. A parameter that every model fits within a tolerance does not
  imitate the mechanism that lets it go beyond. Priors that are met better count, too. Of what a scan's straight line
  did not see, what its refit brought alone.
  """
  common, out = Projector(model), {}
  left = np.concatenate([model.residual[: model.n_train], model.free.deviations(model.values)])
  for name, signature in pool.signatures.items():
    if not signature.testable or name in model.mechanisms:
      continue
    own = {p.name for p in pool.problem.mechanism(name).parameters} & set(model.free.names)
    project = Projector(model, own) if own else common
    direction = signature.direction[None].astype(np.float64)
    imitated = np.array([signature.imitated.get(parameter, 0.0) for parameter in model.free.names])
    change = np.concatenate([project(direction)[0], project.strain(project.answer(direction)[0] + imitated)])
    promise = pool.kept.get(name, 1.0) * explained(change, left, pool.problem.mechanism(name).signed)
    out[name] = max(promise, _unforeseen(pool, name))
  return out


def _unforeseen(pool: Pool, name: str) -> float:
  """Nats that a mechanism's refit brought, where the scan had promised less; else 0."""
  alone = pool.models.get(frozenset([name]))
  brought = pool.base.cost - alone.cost if alone is not None else 0.0
  return brought if brought > max(pool.signatures[name].gain, 0.0) else 0.0


def _kept(pool: Pool, name: str) -> float:
  """Part of the scan's promise that a mechanism's refit kept, at most 1.

  1 where it was not refitted, or where one effect is so strong that nothing refitted without it tells anything.
  """
  alone = pool.models.get(frozenset([name]))
  if alone is None or pool.signatures[name].gain <= 0 or pool.foremost(1)[0].cost < _OVERSHADOWED * pool.base.cost:
    return 1.0
  return float(np.clip((pool.base.cost - alone.cost) / pool.signatures[name].gain, _DOUBTED, 1.0))


def _fit_sets(pool: Pool, sets: Sequence[frozenset[str]], iterations: int) -> None:
  begun = begin_sets(pool, sets)
  refine(pool.problem, [one.model for one in begun], 1)
  came_down = lambda one: one.model.cost < one.parent.cost - _HOPE
  # a step along another basin's columns may lead nowhere, however far there is to go
  _polish(pool, [one.model for one in begun if one.apart and one.model.settled and came_down(one)], 1)
  # a second step is worth its simulations only where the first led somewhere: near the best, or down from the beginning
  near = lambda one: one.model.cost < pool.best_subset(one.key).cost + _HOPE
  refine(pool.problem, [one.model for one in begun if near(one) or came_down(one)], iterations - 1)
  for key in sets:
    best = min((one.model for one in begun if one.key == key), key=lambda m: m.cost)
    pool.models[key] = pool.not_worse(best, pool.best_subset(key))


def refine_stalled(pool: Pool) -> None:
  """Try harder where a refit broke what the scan had promised, with the columns of everything simulated anew.

  The base's columns are those of the recalibrated twin. Where it has bent far to imitate an effect, a step along them
  leads nowhere.
  """
  broken = {n: s.gain for n, s in pool.signatures.items() if s.gain > _PROMISED and _kept(pool, n) < _BROKEN}
  names = sorted(broken, key=lambda n: -broken[n])[:_INSISTED]
  made = [one.model for one in begin_sets(pool, [frozenset([name]) for name in names])]
  _polish(pool, made, _PATIENCE)
  for model in made:
    pool.offer(model)


def refine_leaders(pool: Pool) -> None:
  """Take the leaders and the base on along fresh columns.

  Along stale ones they may stop further from their minima than they lie apart, and their order says nothing.
  """
  if near := _leaders(pool):
    _polish(pool, [pool.base, *near], _PATIENCE)


def _leaders(pool: Pool) -> list[Candidate]:
  """The best single and those that explain half as much, best first; none where it explains next to nothing."""
  ranked = pool.foremost(1)
  most = pool.base.cost - ranked[0].cost if ranked else 0.0
  near = [m for m in ranked[:_RACING] if m.cost - ranked[0].cost <= (1.0 - _NEAR) * most]
  return near if most > _WORTH_A_RACE else []


def _polish(pool: Pool, models: Sequence[Candidate], steps: int) -> None:
  """Steps along fresh columns while they lead somewhere; one that a stale Jacobian led nowhere says nothing."""
  for _ in range(steps):
    before = {id(m): m.cost for m in models}
    for model in models:
      model.settled = False
    refine(pool.problem, models, 1, full=True)
    models = [m for m in models if before[id(m)] - m.cost >= _DONE]


def _without_trifles(pool: Pool) -> None:
  """Fit the sets without a mechanism that is too small to matter and yet worth much: they have not found their minimum.

  What seems to bring them is the freedom that one parameter more gave the fit on its way.
  """
  for _ in range(2):  # of a set of three, one after the other
    best = pool.best(list(pool.models.values()))
    trifles = [n for n in best.mechanisms if shown_size(pool, best, n) < _TRIFLE]
    smaller = [pool.models.get(frozenset(best.mechanisms) - {n}) for n in trifles]
    keys = [m.mechanisms for m in smaller if m and m.mechanisms and m.cost - best.cost > _PROMISED]
    made = [candidate(pool.problem, key, best, pool.priors) for key in keys]
    begin(pool.problem, made)
    _polish(pool, made, _PATIENCE)
    for model in made:
      pool.offer(model)


def _worth_growing(pool: Pool) -> bool:
  """Whether the best pair beats the best single beyond doubt."""
  pairs = pool.of_size(2)
  if not pairs:
    return False
  return _beyond_doubt(pool, pool.best(pairs), pool.best(pool.of_size(1)))


def _beyond_doubt(pool: Pool, larger: Candidate, smaller: Candidate) -> bool:
  gain = compare(larger, smaller, pool.problem.observations)
  return gain.gain > 10.0 and gain.t > 2.0
