"""A force as a table over one or two variables: what is shipped where no short formula holds."""

import dataclasses
import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.twin.formula.variables import VARIABLES

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Table:
  """Straight lines between knots, of one variable or of two; held beyond the first and the last knot.

  F = sum_k c_k h_k, h_k products of hat functions (de Boor, A Practical Guide to Splines, 2001, ch. III).

  Attributes:
    degree: what it acts on.
    knots: of every variable, rising, in its unit; an angle goes round.
    limit: largest magnitude, in the degree's unit.
  """

  degree: str
  knots: Mapping[str, tuple[float, ...]]
  limit: float

  def __post_init__(self) -> None:
    unknown = [name for name in self.knots if name not in VARIABLES]
    if unknown or not 1 <= len(self.knots) <= 2:
      raise ValueError(f"a table of {self.degree} needs one or two of {', '.join(VARIABLES)}, not {list(self.knots)}")
    for name, at in self.knots.items():
      if len(at) < 2 or any(b <= a for a, b in itertools.pairwise(at)):
        raise ValueError(f"the knots of {name} in the table of {self.degree} must rise: {list(at)}")

  @property
  def variables(self) -> frozenset[str]:
    return frozenset(self.knots)

  @property
  def terms(self) -> tuple[str, ...]:
    """What each coefficient belongs to: speed=0.5 yaw_rate=1."""
    axes = [[f"{name}={x:.3g}" for x in at] for name, at in self.knots.items()]
    return tuple(" ".join(at) for at in itertools.product(*axes))

  def basis(self, values: Mapping[str, Array], widths: Mapping[str, float]) -> Array:
    """Products of hats, (..., K), of variables (...) in their units; `widths` is for a law with signs, see
    `Law.basis`, and not read here."""
    axes = [hats(values[name], np.array(at), VARIABLES[name].angular) for name, at in self.knots.items()]
    if len(axes) == 1:
      return axes[0]
    return (axes[0][..., :, None] * axes[1][..., None, :]).reshape(*axes[0].shape[:-1], -1)


def hats(x: Array, knots: Array, angular: bool = False) -> Array:
  """Hat functions at x (...), (..., K). Of an angle the last knot is the first one a turn later, and has no hat."""
  x = np.clip(x, knots[0], knots[-1]) if not angular else knots[0] + np.mod(x - knots[0], knots[-1] - knots[0])
  left = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
  part = (x - knots[left]) / (knots[left + 1] - knots[left])
  out = np.zeros((*np.shape(x), len(knots)))
  np.put_along_axis(out, left[..., None], (1.0 - part)[..., None], axis=-1)
  np.put_along_axis(out, left[..., None] + 1, part[..., None], axis=-1)
  if angular:
    out[..., 0] += out[..., -1]
    out[..., -1] = 0.0
  return out
