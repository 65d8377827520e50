"""Ways back between minima: what was found with a mechanism is offered to models without it, and the reverse.

The cost has several minima. A search that compares a model at one with a model at another compares places, not physics.
"""

from collections.abc import Sequence

from calibration.diagnosis.candidates import Candidate, begin, candidate, refine
from calibration.diagnosis.pool import Pool

LIKELY = 5  # best singles that are tried from elsewhere, too
_RETURNING = 4  # Gauss-Newton steps for a smaller set from where a larger one ended
_LEADING = 4  # steps with fresh columns for a model of an earlier search


def refit_subsets(pool: Pool, best: Candidate) -> float:
  """Fit the sets one mechanism smaller, and the base, from a model's estimates too, and keep what fits better.

  The cost has several minima. One that was only reached with a mechanism in the model may not need it.

  Args:
    pool: all fitted models; its smaller sets may be replaced.
    best: the model to begin at.

  Returns:
    by how many nats the base came down.
  """
  before = pool.base.cost
  smaller = dict.fromkeys([frozenset(), *(frozenset(best.mechanisms) - {name} for name in best.mechanisms)])
  made = [candidate(pool.problem, sorted(key), best, pool.priors) for key in smaller]
  begin(pool.problem, made)
  refine(pool.problem, made, _RETURNING)
  for model in made:
    pool.offer(model)
  return before - pool.base.cost


def refit_rivals(pool: Pool, best: Candidate) -> None:
  """Fit the likely singles from the base that came down: left where they were they would be no rivals to the best.

  Args:
    pool: all fitted models; singles in it may be replaced.
    best: the model that showed the way; it stays as it is.
  """
  others = [m for m in pool.of_size(1) if m.mechanisms != best.mechanisms]
  made = []
  for model in sorted(others, key=lambda m: m.cost)[:LIKELY]:
    own = {p.name for name in model.mechanisms for p in pool.problem.mechanism(name).parameters}
    start = {name: value for name, value in model.free.named(model.values).items() if name in own}
    made.append(candidate(pool.problem, model.mechanisms, pool.base, pool.priors, start))
  begin(pool.problem, made)
  refine(pool.problem, made, _RETURNING)
  for model in made:
    pool.offer(model)


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
