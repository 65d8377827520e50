"""The master filter: fusion of the two local estimates of the position, nothing fed back.

Source: the paper's eq. (master), after Carlson, Federated square root filter for decentralized parallel processes,
IEEE Trans. Aerospace and Electronic Systems 26(3), 1990.
"""

from typing import Any

import numpy as np

Position = tuple[Any, Any]  # floats or arrays (N,)
Symmetric = tuple[Any, Any, Any]  # xx, xy, yy


def fuse_positions(p1: Position, c1: Symmetric, p2: Position, c2: Symmetric) -> tuple[Position, Symmetric]:
  """P_f = (P1^-1 + P2^-1)^-1 and P_f (P1^-1 x1 + P2^-1 x2), written out.

  As x = x1 + P1 (P1 + P2)^-1 (x2 - x1), P = P1 - P1 (P1 + P2)^-1 P1, on floats and on arrays (N,). Exact when the local
  errors are independent; local filters that share a measurement at full weight break that, and P_f is then too small.

  The surer of the two stands for x1, so that nothing large is taken from something large. Where the other is so unsure
  that rounding makes the sum's determinant smaller than it can be (its variance along x times what x leaves of the
  surer's along y), the surer stands alone.
  """
  choose = np.where if isinstance(c1[0], np.ndarray) else _one_of
  swap = c2[0] + c2[2] < c1[0] + c1[2]
  (a, b, d), (e, f, g) = _ordered(choose, swap, c1, c2)
  (x, y), (x_other, y_other) = _ordered(choose, swap, p1, p2)
  xx, xy, yy = a + e, b + f, d + g
  det, least = xx * yy - xy * xy, xx * (d - b * b / a)
  det = choose(det < least * (1.0 - 1e-9), np.inf, det)
  k00, k01 = (a * yy - b * xy) / det, (b * xx - a * xy) / det
  k10, k11 = (b * yy - d * xy) / det, (d * xx - b * xy) / det
  dx, dy = x_other - x, y_other - y
  position = x + k00 * dx + k01 * dy, y + k10 * dx + k11 * dy
  return position, (a - k00 * a - k01 * b, b - k00 * b - k01 * d, d - k10 * b - k11 * d)


def _ordered(choose: Any, swap: Any, one: tuple, other: tuple) -> tuple[tuple, tuple]:
  """Two tuples, exchanged where asked."""
  pairs = list(zip(one, other, strict=True))
  return tuple(choose(swap, b, a) for a, b in pairs), tuple(choose(swap, a, b) for a, b in pairs)


def _one_of(which: bool, one: float, other: float) -> float:
  """As `numpy.where` of floats."""
  return one if which else other
