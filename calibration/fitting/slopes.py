"""Slopes of residuals by finite differences, and those that a search knows already."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import ParameterSet

Array = NDArray[np.float64]
Residual = Callable[[Array], Array]  # (n, p) -> (n, M), whitened: a perfect model costs M / 2

# How slopes are taken: by forward differences, or by central ones whose half width is given in scales, or is the
# deviation of a parameter, all others held: over it a cost changes by half a nat, so that slopes are those of where the
# posterior lies, and neither those of a kink within it nor of what comes far outside.
Stencil = float | Literal["forward", "deviation"]
WIDEST = 0.3  # scales, of a parameter that says nothing
_NEAR = 0.1  # of a stencil's half width: slopes over it are those of a point so near, to a tenth of what they change by


class NotFinite(ValueError):
  """A simulation that a fit needs is not finite."""


class Slopes:
  """Jacobians of a residual, taken as they are needed and kept.

  One serves again within a tenth of its stencil, and after a constant was added to the residual: a surrogate that is
  put right at another place has its slopes still.
  Source of a deviation's width: James and Roos, Minuit, Computer Physics Communications 10, 1975.

  Args:
    together: the part of the driving of every value, (M,); the values of one jump together, those of others do not.

  Attributes:
    evaluations: simulations that the last call of `at` took.
    widths: half widths of that call, (p,), in the parameters' units.
  """

  def __init__(self, together: NDArray[np.int64] | None = None) -> None:
    self._together = together
    self._kept: dict[Stencil, tuple[Array, Array, Array]] = {}
    self._newest: Array | None = None
    self.evaluations, self.widths = 0, np.zeros(0)

  def forget(self) -> None:
    """The residual has changed by more than a constant."""
    self._kept.clear()

  def weighed(self, factor: Array) -> "Slopes":
    """Those of the residual times a factor, (M,)."""
    made = Slopes(self._together)
    made._kept = {key: (place, widths, slopes * factor[:, None]) for key, (place, widths, slopes) in self._kept.items()}
    made._newest = None if self._newest is None else self._newest * factor[:, None]
    return made

  def at(
    self, residual: Residual, parameters: ParameterSet, theta: Array, r: Array, stencil: Stencil, step: float = 0.02
  ) -> Array:
    """Jacobian, (M, p).

    Args:
      r: residual at theta, (M,); forward differences need it.
      step: of forward differences, in scales.

    Raises:
      NotFinite: a simulation within the stencil.
    """
    self.evaluations = 0
    for known in (stencil, "deviation") if stencil == "forward" else (stencil,):  # central ones are better
      place, self.widths, jacobian = self._kept.get(known, (theta, np.zeros(0), r))
      if len(self.widths) == len(theta) and np.all(np.abs(theta - place) <= _NEAR * self.widths):
        return jacobian
    if stencil == "forward" or (stencil == "deviation" and self._newest is None):
      self.widths, self.evaluations = step * parameters.scale, len(theta)
      jacobian = self._newest = finite_differences(residual, parameters, theta, r, step)
    if stencil != "forward":
      self.widths = self._half_widths(parameters, theta, stencil)
      self.evaluations += 2 * len(theta)
      smooth = (r, self._together) if stencil == "deviation" and self._together is not None else None
      jacobian = self._newest = central_differences(residual, parameters, theta, self.widths, smooth)
    self._kept[stencil] = theta.copy(), self.widths, jacobian
    return jacobian

  def _half_widths(self, parameters: ParameterSet, theta: Array, stencil: Stencil) -> Array:
    if self._newest is None or isinstance(stencil, float):
      return float(stencil) * parameters.scale
    precision = np.sum(self._newest**2, axis=0) + parameters.deviation_slopes(theta) ** 2
    return np.minimum(WIDEST * parameters.scale, 1.0 / np.sqrt(np.maximum(precision, 1e-300)))


def finite_differences(
  residual: Residual, parameters: ParameterSet, theta: Array, r: Array, step: float = 0.02
) -> Array:
  """Forward-difference Jacobian, (M, p); a step that would leave the bounds is mirrored."""
  h = step * parameters.scale
  h = np.where(theta + h > parameters.upper, -h, h)
  moved = residual(theta + np.diag(h))
  jacobian = ((moved - r) / h[:, None]).T
  if not np.isfinite(jacobian).all():
    bad = [p.name for i, p in enumerate(parameters) if not np.isfinite(jacobian[:, i]).all()]
    raise NotFinite(f"the simulation is not finite when {', '.join(bad)} moves by {step:g} of its scale")
  return jacobian


def central_differences(
  residual: Residual,
  parameters: ParameterSet,
  theta: Array,
  half: Array,
  smooth: tuple[Array, NDArray[np.int64]] | None = None,
) -> Array:
  """Jacobian, (M, p), by central differences over stencils of half widths (p,), in units; less at a bound.

  Args:
    smooth: the residual at theta, (M,), and the part of the driving of every value, (M,). A part that jumps within a
      stencil, as where a wheel touches the floor a step sooner, then has the slopes of the side without the jump.

  Raises:
    NotFinite: a simulation within the stencil.
  """
  above, below = np.minimum(theta + half, parameters.upper), np.maximum(theta - half, parameters.lower)
  moved = residual(np.concatenate([theta + np.diag(above - theta), theta + np.diag(below - theta)]))
  upper, lower = moved[: len(theta)], moved[len(theta) :]
  jacobian = ((upper - lower) / (above - below)[:, None]).T
  if not np.isfinite(jacobian).all():
    bad = [
      f"{p.name} moves by {h:.3g} {p.unit}"
      for p, h, column in zip(parameters, half, jacobian.T, strict=True)
      if not np.isfinite(column).all()
    ]
    raise NotFinite(f"the simulation is not finite when {', '.join(bad)}")
  if smooth is not None:
    for i in np.flatnonzero((above > theta) & (below < theta)):
      sides = (upper[i] - smooth[0]) / (above - theta)[i], (smooth[0] - lower[i]) / (theta - below)[i]
      jacobian[:, i] = _smoother(jacobian[:, i], *sides, smooth[1])
  return jacobian


def _smoother(central: Array, forward: Array, backward: Array, part: NDArray[np.int64]) -> Array:
  """Slopes (M,), of each part central ones, or the smaller of two that differ by more than it.

  Source: the choice of the smoother stencil, Harten, Engquist, Osher and Chakravarthy, Uniformly high order accurate
  essentially non-oscillatory schemes III, Journal of Computational Physics 71, 1987.
  """
  power = lambda values: np.bincount(part, values**2)
  ahead, behind, apart = power(forward), power(backward), power(forward - backward)
  kinked = apart > np.minimum(ahead, behind)
  return np.where(kinked[part], np.where((ahead < behind)[part], forward, backward), central)


def broyden(jacobian: Array, r: Array, theta: Array, outcome: Array, candidate: Array, scale: Array) -> Array:
  """Jacobian corrected by what one step showed (Broyden's rank-one update in units of scale), (M, p).

  A step of less than a hundredth of the scales shows rounding and chatter of the simulation, not its slope.
  """
  step = (candidate - theta) / scale
  power = float(step @ step)
  if power < 1e-4 or not np.isfinite(outcome).all():
    return jacobian
  surprise = outcome - r - jacobian @ (candidate - theta)
  return jacobian + np.outer(step / scale, surprise / power).T  # by columns, as the Jacobian lies in memory
