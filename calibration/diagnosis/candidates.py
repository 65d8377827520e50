"""Models the search compares: the base twin plus a set of mechanisms, fitted side by side.

All candidates of a round share one batched simulation per half-iteration. The Jacobian of the base
parameters is taken over from the recalibrated twin and corrected by Broyden's rank-one update
(Nocedal and Wright, 11.1); only the columns of the mechanisms' own parameters are simulated anew.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.likelihood import Problem
from calibration.fitting.optimiser import bounded_solve, inverse_curvature, prior_cost, prior_gradient
from calibration.fitting.slopes import broyden
from qcar_twin.parameters import ParameterSet

Array = NDArray[np.float64]

# precisions of the trial steps' restraint, in units of each parameter's scale
_FRESH, _STALE = (0.0, 10.0, 300.0), (1.0, 100.0)
HELD = _STALE[0]  # the least restraint along slopes that were taken elsewhere
_STEP = 0.03  # of a forward difference, in units of the parameter's scale
_LENGTHS = (1.0, 2.0)  # of a step along fresh columns: a small valley in a rough slope is stepped over


@dataclasses.dataclass
class Candidate:
  """A model under trial.

  Attributes:
    mechanisms: ids added to the base twin, () for the base twin itself.
    free: parameters that are fitted.
    theta: full vector, (P,).
    residual: whitened, (M,).
    jacobian: with respect to the free parameters, (M, p).
    n_train: the first so many rows are fitted, the others only judge.
    settled: the last iteration gained next to nothing.
    validation_current: the rows that only judge belong to the present estimates.
    confirmed: the residual is MuJoCo's, where something else searched; corrected: so is the minimum. See confirm.py.
  """

  mechanisms: tuple[str, ...]
  free: ParameterSet
  theta: Array
  residual: Array
  jacobian: Array
  values: Array
  n_train: int
  settled: bool = False
  validation_current: bool = True
  confirmed: bool = False
  corrected: bool = False

  @property
  def cost(self) -> float:
    """Half the sum of squares plus the prior, nats."""
    return half_square(self.residual[: self.n_train]) + prior_cost(self.values, self.free)

  @property
  def curvature(self) -> Array:
    """Posterior curvature, (p, p)."""
    seen = self.jacobian[: self.n_train]
    return seen.T @ seen + np.diag(self.free.deviation_slopes(self.values) ** 2)

  @property
  def gradient(self) -> Array:
    """Slope of the cost, (p,)."""
    seen = self.jacobian[: self.n_train].T @ self.residual[: self.n_train]
    return seen + prior_gradient(self.values, self.free)

  @property
  def std(self) -> Array:
    """Posterior standard deviations of the free parameters, (p,)."""
    return np.sqrt(np.maximum(np.diag(inverse_curvature(self.curvature, self.free)), 0.0))

  def value(self, name: str) -> float:
    """Estimate of a free parameter."""
    return float(self.values[self.free.index(name)])

  def estimate(self, name: str) -> tuple[float, float]:
    """Value and standard deviation of a free parameter."""
    i = self.free.index(name)
    return float(self.values[i]), float(self.std[i])


def promise(model: Candidate, held: float = 0.0) -> float:
  """Nats that a Gauss-Newton step along the model's slopes would bring, held back as `refine` does along stale ones."""
  curvature, gradient = model.curvature, model.gradient
  step = bounded_solve(curvature + held * _unit(model), gradient, model.values, model.free) - model.values
  return -float(gradient @ step + 0.5 * step @ curvature @ step)


def half_square(values: Array) -> float:
  return 0.5 * float(values @ values)


def candidate(
  problem: Problem,
  mechanisms: Sequence[str],
  parent: Candidate | None,
  priors: ParameterSet,
  start: dict[str, float] | None = None,
) -> Candidate:
  """A model that starts from its parent's estimates; not yet simulated.

  A base parameter that a mechanism declares, too, is freed from its prior: the ruler's error becomes an effect.

  Args:
    problem: residuals.
    mechanisms: ids in the model.
    parent: a fitted model whose estimates and Jacobian columns are taken over.
    priors: declarations of the base parameters.
    start: first values of some parameters.
  """
  added = [p for name in mechanisms for p in problem.mechanism(name).parameters]
  freed = {p.name for p in added}
  free = ParameterSet([*(p for p in priors if p.name not in freed), *added])
  values = free.nominal
  jacobian = np.zeros((len(problem.observations), len(free)), order="F")  # columns are what is filled and copied
  if parent is not None:
    taken = [i for i, name in enumerate(free.names) if name in parent.free]
    theirs = [parent.free.index(free.names[i]) for i in taken]
    values[taken] = parent.values[theirs]
    for i, k in zip(taken, theirs, strict=True):
      jacobian[:, i] = parent.jacobian[:, k]
  empty = np.zeros(len(problem.observations))
  made = Candidate(tuple(mechanisms), free, problem.parameters.nominal, empty, jacobian, values, problem.n_train)
  return started(problem, made, start or {})


def started(problem: Problem, model: Candidate, start: Mapping[str, float]) -> Candidate:
  """The same model with other first values of some parameters; the two share a Jacobian: fit one of them on."""
  values = model.values.copy()
  for name, value in start.items():
    if name in model.free:
      values[model.free.index(name)] = value
  values = np.clip(values, model.free.lower, model.free.upper)
  theta = problem.embed(model.free.names, values, problem.parameters.nominal)[0]
  return dataclasses.replace(model, values=values, theta=theta)


def simulate(problem: Problem, candidates: Sequence[Candidate]) -> None:
  """Residuals of candidates at their present estimates, in one batch."""
  if candidates:
    for item, residual in zip(candidates, problem.residual(np.stack([c.theta for c in candidates])), strict=True):
      item.residual = residual


def begin(problem: Problem, candidates: Sequence[Candidate]) -> None:
  """The same of what is fitted alone: what only judges is for refine to predict, where each of them ends.

  Of several starts most are given up before anything is judged by them.
  """
  if candidates:
    started = problem.fitted_residual(np.stack([c.theta for c in candidates]))
    for item, residual in zip(candidates, started, strict=True):
      item.residual = np.concatenate([residual, np.zeros(len(problem.observations) - item.n_train)])
      item.validation_current = False


def refine(problem: Problem, candidates: Sequence[Candidate], iterations: int, full: bool = False) -> None:
  """Gauss-Newton on every candidate at once; a step that does not lower the cost is not taken.

  Slopes and steps are simulated on what is fitted alone; what only judges is predicted where each candidate ends. Its
  rows of the Jacobian stay those the candidate was made with.

  Args:
    problem: residuals.
    candidates: simulated already, or begun.
    iterations: at most this many.
    full: simulate the base parameters' columns too.
  """
  for _ in range(iterations):
    active = [c for c in candidates if not c.settled]
    if not active:
      break
    _fill_columns(problem, active, full)
    _try_steps(problem, active, full)
  _judge(problem, [c for c in candidates if not c.validation_current])


def _fill_columns(problem: Problem, candidates: Sequence[Candidate], full: bool) -> None:
  """Slopes of what is fitted, along the mechanisms' own parameters, or along all where `full`."""
  jobs = []
  for item in candidates:
    own = {p.name for name in item.mechanisms for p in problem.mechanism(name).parameters}
    kept = set() if full else set(problem.base) - own
    jobs += [(item, i, difference_step(item, i)) for i, name in enumerate(item.free.names) if name not in kept]
  if not jobs:
    return
  moved = []
  for item, i, h in jobs:
    theta = item.theta.copy()
    theta[problem.parameters.index(item.free.names[i])] += h
    moved.append(theta)
  for (item, i, h), residual in zip(jobs, problem.fitted_residual(np.stack(moved)), strict=True):
    item.jacobian[: item.n_train, i] = (residual - item.residual[: item.n_train]) / h


def difference_step(item: Candidate, i: int) -> float:
  """Step of a free parameter for its Jacobian column, away from its upper bound."""
  h = _STEP * item.free.scale[i]
  return -h if item.values[i] + h > item.free.upper[i] else h


def _try_steps(problem: Problem, candidates: Sequence[Candidate], fresh: bool) -> None:
  trials = [(item, values) for item in candidates for values in _steps(item, fresh)]
  thetas = [problem.embed(item.free.names, values, item.theta)[0] for item, values in trials]
  outcomes = problem.fitted_residual(np.stack(thetas))
  for item in candidates:
    rows = [k for k, (owner, _) in enumerate(trials) if owner is item]
    costs = [half_square(outcomes[k]) + prior_cost(trials[k][1], item.free) for k in rows]
    best = rows[int(np.argmin(costs))]
    before, gain = item.cost, item.cost - min(costs)
    first = rows[0]
    seen, here = item.jacobian[: item.n_train], item.residual[: item.n_train]
    item.jacobian[: item.n_train] = broyden(seen, here, item.values, outcomes[first], trials[first][1], item.free.scale)
    if gain > 0:
      item.residual = np.concatenate([outcomes[best], item.residual[item.n_train :]])
      item.theta, item.values, item.validation_current = thetas[best], trials[best][1], False
      item.confirmed = item.corrected = False
    item.settled = gain < 1e-3 * abs(before) ** 0.5 + 0.3


def _judge(problem: Problem, candidates: Sequence[Candidate]) -> None:
  """Predict what only judges where candidates stand now."""
  if candidates:
    for item, rest in zip(candidates, problem.judging_residual(np.stack([c.theta for c in candidates])), strict=True):
      item.residual = np.concatenate([item.residual[: item.n_train], rest])
      item.validation_current = True


def _steps(item: Candidate, fresh: bool) -> list[Array]:
  """Trial estimates: Gauss-Newton steps held back more or less by a prior about where the model stands.

  What the data hardly know would otherwise run far along a Jacobian that was taken elsewhere. Along fresh columns
  every step is also tried at twice its length: the cost of wheels that slide is so rough that a slope ends in many
  small valleys, each a hundredth of the way.
  """
  gradient, curvature, unit = item.gradient, item.curvature, _unit(item)
  holds, lengths = (_FRESH, _LENGTHS) if fresh else (_STALE, (1.0,))
  ends = [bounded_solve(curvature + hold * unit, gradient, item.values, item.free) for hold in holds]
  return [
    np.clip(item.values + length * (end - item.values), item.free.lower, item.free.upper)
    for end in ends
    for length in lengths
  ]


def _unit(item: Candidate) -> Array:
  """Precision of one unit of every free parameter's scale, (p, p)."""
  return np.diag(1.0 / item.free.scale**2)
