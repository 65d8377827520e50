"""The master filter: fusion of the two local estimates of the position, nothing fed back.

Source: the paper's eq. (master), after Carlson, Federated square root filter for decentralized parallel processes,
IEEE Trans. Aerospace and Electronic Systems 26(3), 1990.
"""

from typing import Any

Position = tuple[Any, Any]  # floats or arrays (N,)
Symmetric = tuple[Any, Any, Any]  # xx, xy, yy


def fuse_positions(p1: Position, c1: Symmetric, p2: Position, c2: Symmetric) -> tuple[Position, Symmetric]:
  """P_f = (P1^-1 + P2^-1)^-1 and P_f (P1^-1 x1 + P2^-1 x2), written out.

  As x = x1 + P1 (P1 + P2)^-1 (x2 - x1), P = P1 - P1 (P1 + P2)^-1 P1, on floats and on arrays (N,). Exact when the local
  errors are independent; local filters that share a measurement at full weight break that, and P_f is then too small.
  """
  (a, b, d), (e, f, g) = c1, c2
  xx, xy, yy = a + e, b + f, d + g
  det = xx * yy - xy * xy
  k00, k01 = (a * yy - b * xy) / det, (b * xx - a * xy) / det
  k10, k11 = (b * yy - d * xy) / det, (d * xx - b * xy) / det
  dx, dy = p2[0] - p1[0], p2[1] - p1[1]
  position = p1[0] + k00 * dx + k01 * dy, p1[1] + k10 * dx + k11 * dy
  return position, (a - k00 * a - k01 * b, b - k00 * b - k01 * d, d - k10 * b - k11 * d)
