"""Batched Levenberg-Marquardt for maximum a posteriori estimates.

The core sees a flat vector and a vectorised residual: all finite-difference columns and all trial
steps of an iteration are one batched simulation. Source of the method: Nocedal and Wright,
Numerical Optimization, 2nd ed., chapter 10; the pseudo-Huber loss: Hartley and Zisserman, A6.8.

Wheels that lock, slip and catch again make a cost rough: its slope over a hundredth of a parameter's scale is not that
of the valley. Where forward differences see no more gain, central differences go on over wide stencils, then over
one deviation (implicit filtering: Gilmore and Kelley, SIAM Journal on Optimization 5, 1995).
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from calibration.fitting.slopes import WIDEST, Array, NotFinite, Residual, Slopes, Stencil, broyden
from qcar_twin.parameters import ParameterSet

_LEAST_GAIN = 1.0  # nats an iteration must bring to be followed by another
# actual over predicted reduction of the cost: from _SERVES on the Jacobian serves for another step, from _TRUSTED on a
# step needs no others to be tried with it
_SERVES, _TRUSTED = 0.7, 0.9
# factors on the damping: of the step that is tried alone, of those tried with it, and after all of them failed
_EASE, _RUNGS, _STIFFER = 0.01, (0.1, 1.0, 10.0, 100.0), 1e4
_FLAT = 1e-14  # of the largest curvature: rounding
FORWARD: tuple[Stencil, ...] = ("forward",)
STENCILS: tuple[Stencil, ...] = (WIDEST, "deviation")  # of the central differences that a search ends with


@dataclasses.dataclass(frozen=True)
class Fit:
  """What a fit found.

  Attributes:
    parameters: the fitted parameters, p of them.
    theta: estimates, (p,).
    covariance: inverse of the posterior curvature, (p, p); a parameter at its bound keeps its prior variance.
    at_bound: estimates that stopped at a bound, (p,).
    identifiable: posterior variance below half the prior's, (p,): the data said something about it.
    cost: half the robust sum of squares plus the prior's half sum of squares.
    data_cost: the first part alone.
    residual: whitened residual at theta, (M,).
    jacobian: d residual / d theta, (M, p), from the last iteration, corrected by the steps since.
    iterations: cost after each iteration.
    evaluations: simulations of the whole data set that were spent.
  """

  parameters: ParameterSet
  theta: Array
  covariance: Array
  at_bound: NDArray[np.bool_]
  identifiable: NDArray[np.bool_]
  cost: float
  data_cost: float
  residual: Array
  jacobian: Array
  iterations: tuple[float, ...]
  evaluations: int

  @property
  def std(self) -> Array:
    """Posterior standard deviations, (p,)."""
    return np.sqrt(np.diag(self.covariance))

  def named(self) -> dict[str, float]:
    return self.parameters.named(self.theta)

  def table(self) -> dict[str, dict[str, float | bool | str]]:
    """Per parameter: value, std, unit, prior, at_bound, identifiable; ready for JSON."""
    return {
      p.name: {
        "value": float(self.theta[i]),
        "std": float(self.std[i]),
        "unit": p.unit,
        "prior": p.nominal,
        "prior_std": float(self.parameters.std[i]),
        "at_bound": bool(self.at_bound[i]),
        "identifiable": bool(self.identifiable[i]),
      }
      for i, p in enumerate(self.parameters)
    }


def fit(
  residual: Residual,
  parameters: ParameterSet,
  start: Array | None = None,
  iterations: int = 8,
  robust: float = 3.0,
  tolerance: float = 3e-4,
  step: float = 0.02,
  progress: Callable[[int, float], None] | None = None,
  stencils: Sequence[Stencil] = FORWARD,
  slopes: Slopes | None = None,
) -> Fit:
  """Minimise half the robust sum of squared residuals plus the prior.

  Args:
    residual: whitened residuals of n parameter vectors, (n, p) -> (n, M); NaN rows count as infinitely bad.
    parameters: bounds and priors, Gaussian or log-normal.
    start: first guess, (p,); the parameters' own by default.
    iterations: at most this many steps; a Jacobian serves up to three, corrected by Broyden's update.
    robust: pseudo-Huber width in standard deviations; np.inf for plain least squares.
    tolerance: stop when an iteration lowers the cost by less than this share of it, or by less than a nat; with 0
      such an iteration must have had a fresh Jacobian.
    step: finite-difference step as a share of each parameter's scale.
    progress: called with the iteration and the cost.
    stencils: how slopes are taken until no gain is seen, one after the other; all of them must agree at the end.
    slopes: Jacobians known from an earlier search of the same residual, or of one that differs by a constant.

  Raises:
    NotFinite: the residual at the start, or a simulation near it.
  """
  theta, r = _begun(residual, parameters, start)
  costs, jacobian = [_cost(r, theta, parameters, robust)], np.zeros((len(r), len(theta)))
  damping, evaluations, failures, renew, fresh, known = 1e-3, 1, 0, True, False, slopes or Slopes()
  coming = list(stencils)
  for k in range(iterations):
    if renew and not fresh:
      jacobian, fresh = known.at(residual, parameters, theta, r, coming[0], step), True
      evaluations += known.evaluations
    tried = _try(residual, parameters, theta, r, jacobian, costs[-1], damping, robust)
    evaluations, gain = evaluations + tried.evaluations, costs[-1] - tried.cost
    small = gain < max(_LEAST_GAIN, tolerance * abs(costs[-1]))
    if gain > 0:
      jacobian = broyden(jacobian, r, theta, tried.outcome, tried.theta, parameters.scale)
      theta, r = tried.theta, tried.outcome
      costs.append(tried.cost)
    damping = float(np.clip(damping * (tried.ease if gain > 0 else _STIFFER), 1e-8, 1e6))
    if progress:
      progress(k + 1, costs[-1])
    failures = 0 if gain > 0 else failures + 1
    # without a tolerance the minimum is sought to a nat, and only a fresh Jacobian knows that there is none left
    sure = fresh or (tolerance > 0 and tried.ratio >= _TRUSTED)
    if (small and sure and (gain > 0 or tried.predicted < _LEAST_GAIN)) or failures > 2:
      if len(coming) == 1:
        break
      coming, damping, failures, renew, fresh = coming[1:], 1e-3, 0, True, False
      continue
    fresh = fresh and gain <= 0
    # a Jacobian that foretold the gain well is good for one more step
    renew = (k + 1) % 3 == 0 or tried.ratio < _SERVES
  return _finish(parameters, theta, r, jacobian, costs, evaluations, robust)


def _begun(residual: Residual, parameters: ParameterSet, start: Array | None) -> tuple[Array, Array]:
  """The first guess within its bounds, and the residual there."""
  theta = np.clip(parameters.start if start is None else np.asarray(start, float), parameters.lower, parameters.upper)
  r = residual(theta[None])[0]
  if not np.isfinite(r).all():
    raise NotFinite("the simulation at the first guess is not finite; start from nominal parameters")
  return theta, r


@dataclasses.dataclass(frozen=True)
class _Trial:
  """A simulated step: estimates, residual, cost, predicted reduction, actual / predicted, factor on the damping."""

  theta: Array
  outcome: Array
  cost: float
  predicted: float
  ratio: float
  ease: float
  evaluations: int


def _try(
  residual: Residual, parameters: ParameterSet, theta: Array, r: Array, jacobian: Array, cost: float, damping: float,
  robust: float,
) -> _Trial:  # fmt: skip
  """A step as good as undamped; where it doesn't bring what the Jacobian predicted, the best of it and shorter ones.

  Where less than a nat is predicted there is nothing to be found by others.
  """

  def judged(candidates: list[Array], eases: tuple[float, ...], evaluations: int) -> _Trial:
    outcomes = residual(np.stack(candidates))
    costs = [_cost(o, t, parameters, robust) for o, t in zip(outcomes, candidates, strict=True)]
    best = int(np.argmin(costs))
    predicted = cost - _cost(r + jacobian @ (candidates[best] - theta), candidates[best], parameters, robust)
    ratio = (cost - costs[best]) / max(predicted, 1e-300)
    return _Trial(candidates[best], outcomes[best], costs[best], predicted, ratio, eases[best], evaluations)

  curvature = posterior_curvature(jacobian, r, theta, parameters, robust)
  gradient = jacobian.T @ (r * robust_weights(r, robust)) + prior_gradient(theta, parameters)
  damped = lambda factor: curvature + damping * factor * np.diag(np.diag(curvature))
  step = lambda factor: bounded_solve(damped(factor), gradient, theta, parameters)
  first = judged([step(_EASE)], (_EASE,), 1)
  if first.ratio >= _TRUSTED or first.predicted < _LEAST_GAIN:
    return first
  spent, half = 2 + len(_RUNGS), 0.5 * (theta + first.theta)
  others = judged([*(step(factor) for factor in _RUNGS), half], (*_RUNGS, 1.0), spent)
  return min((dataclasses.replace(first, evaluations=spent), others), key=lambda t: t.cost)


def with_jacobian(fitted: Fit, jacobian: Array, robust: float) -> Fit:
  """The same estimates with covariance and flags from a Jacobian, (M, p), taken where the fit ended.

  Args:
    robust: pseudo-Huber width the fit was made with.
  """
  costs = list(fitted.iterations)
  return _finish(fitted.parameters, fitted.theta, fitted.residual, jacobian, costs, fitted.evaluations, robust)


def robust_weights(r: Array, width: float) -> Array:
  """Weights of the pseudo-Huber loss, rho' / r, (M,)."""
  return np.ones_like(r) if not np.isfinite(width) else 1.0 / np.sqrt(1.0 + (r / width) ** 2)


def robust_cost(r: Array, width: float) -> Array:
  """Half the pseudo-Huber loss of each residual: width^2 (sqrt(1 + r^2 / width^2) - 1)."""
  return 0.5 * r**2 if not np.isfinite(width) else width**2 * (np.sqrt(1.0 + (r / width) ** 2) - 1.0)


def posterior_curvature(jacobian: Array, r: Array, theta: Array, parameters: ParameterSet, robust: float) -> Array:
  """J' W J plus the prior's precision at theta, (p, p)."""
  weighted = jacobian * robust_weights(r, robust)[:, None]
  return jacobian.T @ weighted + np.diag(parameters.deviation_slopes(theta) ** 2)


def prior_cost(theta: Array, parameters: ParameterSet) -> float:
  return 0.5 * float(np.sum(parameters.deviations(theta) ** 2))


def prior_gradient(theta: Array, parameters: ParameterSet) -> Array:
  """Slope of `prior_cost`, (p,)."""
  return parameters.deviations(theta) * parameters.deviation_slopes(theta)


def _cost(r: Array, theta: Array, parameters: ParameterSet, robust: float) -> float:
  if not np.isfinite(r).all():
    return np.inf
  return float(np.sum(robust_cost(r, robust))) + prior_cost(theta, parameters)


def bounded_solve(curvature: Array, gradient: Array, theta: Array, parameters: ParameterSet) -> Array:
  """Minimiser of a quadratic model within bounds, by an active set (Stark and Parker's BVLS, 1995).

  Solved in units of each parameter's scale: a motor's inertia and a tyre's stiffness are ten powers of ten apart.
  """
  scale = parameters.scale
  h, g = curvature * np.outer(scale, scale), gradient * scale
  lower, upper = (parameters.lower - theta) / scale, (parameters.upper - theta) / scale
  move = -np.linalg.lstsq(h, g, rcond=None)[0]
  if np.any((move < lower) | (move > upper)):
    power, along = np.linalg.eigh(h)
    root = np.sqrt(np.maximum(power, _FLAT * power[-1]))
    move = lsq_linear(root[:, None] * along.T, -(along.T @ g) / root, (lower, upper), method="bvls").x
  return np.clip(theta + move * scale, parameters.lower, parameters.upper)


def inverse_curvature(curvature: Array, parameters: ParameterSet) -> Array:
  """Inverse of a curvature, taken in units of each parameter's scale, (p, p)."""
  scale = np.outer(parameters.scale, parameters.scale)
  return np.linalg.pinv(curvature * scale, hermitian=True) * scale


def _finish(
  parameters: ParameterSet, theta: Array, r: Array, jacobian: Array, costs: list[float], evaluations: int, robust: float
) -> Fit:
  span = parameters.upper - parameters.lower
  at_bound = (theta - parameters.lower < 1e-6 * span) | (parameters.upper - theta < 1e-6 * span)
  prior = parameters.deviation_slopes(theta) ** -2
  covariance = np.diag(prior)
  free = np.flatnonzero(~at_bound)
  loose = ParameterSet(p for p, bound in zip(parameters, at_bound, strict=True) if not bound)
  curvature = posterior_curvature(jacobian[:, free], r, theta[free], loose, robust)
  covariance[np.ix_(free, free)] = inverse_curvature(curvature, loose)
  variance = np.diag(covariance)
  return Fit(
    parameters=parameters,
    theta=theta,
    covariance=covariance,
    at_bound=at_bound,
    identifiable=(variance < 0.5 * prior) & ~at_bound,
    cost=costs[-1],
    data_cost=float(np.sum(robust_cost(r, robust))),
    residual=r,
    jacobian=jacobian,
    iterations=tuple(costs),
    evaluations=evaluations,
  )
