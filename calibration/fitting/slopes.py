"""Slopes of residuals by finite differences, and those that a search knows already."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import ParameterSet

Array = NDArray[np.float64]
Residual = Callable[[Array], Array]  # (n, p) -> (n, M), whitened: a perfect model costs M / 2

# Half width of the narrowest central differences, in scales. No wider than the forward step: the point where a fit
# stands was chosen as the lowest of several, so that its own chatter is on the low side, and forward differences put
# that into every column alike; central differences don't use it.
NARROWEST = 0.02
_NEAR = 0.1  # of a stencil's half width: slopes over it are those of a point so near, to a tenth of what they change by


class NotFinite(ValueError):
  """A simulation that a fit needs is not finite."""


class Slopes:
  """Jacobians of a residual, taken as they are needed and kept.

  One serves again within a tenth of its stencil, and after a constant was added to the residual: a surrogate that is
  put right at another place has its slopes still.

  Attributes:
    evaluations: simulations that the last call of `at` took.
  """

  def __init__(self) -> None:
    self._kept: dict[float, tuple[Array, Array, Array]] = {}
    self.evaluations = 0

  def forget(self) -> None:
    self._kept.clear()

  def at(self, residual: Residual, parameters: ParameterSet, theta: Array, r: Array, half: float, step: float) -> Array:
    """Jacobian, (M, p), over a stencil of this half width; by forward differences of `step` where that is 0.

    Args:
      r: residual at theta, (M,); forward differences need it.

    Raises:
      NotFinite: a simulation within the stencil.
    """
    self.evaluations = 0
    for width in (half,) if half else (half, NARROWEST):  # central differences are the better forward ones
      place, scale, jacobian = self._kept.get(width, (theta, np.zeros(0), r))
      near = _NEAR * (width or step) * parameters.scale
      if np.array_equal(scale, parameters.scale) and np.all(np.abs(theta - place) <= near):
        return jacobian
    if half:
      jacobian, self.evaluations = central_differences(residual, parameters, theta, half), 2 * len(theta)
    else:
      jacobian, self.evaluations = finite_differences(residual, parameters, theta, r, step), len(theta)
    self._kept[half] = theta.copy(), parameters.scale.copy(), jacobian
    return jacobian


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


def central_differences(residual: Residual, parameters: ParameterSet, theta: Array, half: float) -> Array:
  """Jacobian, (M, p), by central differences over stencils `half` of a scale to either side, less at a bound.

  Raises:
    NotFinite: a simulation within the stencil.
  """
  h = half * parameters.scale
  above, below = np.minimum(theta + h, parameters.upper), np.maximum(theta - h, parameters.lower)
  moved = residual(np.concatenate([theta + np.diag(above - theta), theta + np.diag(below - theta)]))
  jacobian = ((moved[: len(theta)] - moved[len(theta) :]) / (above - below)[:, None]).T
  if not np.isfinite(jacobian).all():
    bad = [p.name for i, p in enumerate(parameters) if not np.isfinite(jacobian[:, i]).all()]
    raise NotFinite(f"the simulation is not finite when {', '.join(bad)} moves by {half:g} of its scale")
  return jacobian


def broyden(jacobian: Array, r: Array, theta: Array, outcome: Array, candidate: Array, scale: Array) -> Array:
  """Jacobian corrected by what one step showed (Broyden's rank-one update in units of scale), (M, p).

  A step of less than a hundredth of the scales shows rounding and chatter of the simulation, not its slope.
  """
  step = (candidate - theta) / scale
  power = float(step @ step)
  if power < 1e-4 or not np.isfinite(outcome).all():
    return jacobian
  surprise = outcome - r - jacobian @ (candidate - theta)
  return jacobian + np.outer(surprise / power, step / scale)
