"""A servo that holds a position: second order, exact for a held command.

  q tau^2 delta'' + tau delta' + delta = u,   q = 1 / (2 zeta)^2

(Franklin, Powell and Workman, Digital Control of Dynamic Systems, 3rd ed., 1998, ch. 4). tau is its lag at low
frequencies whatever its damping; q = 0 is a first-order lag, 0.25 critical damping, 0.5 a damping ratio of 0.71.
Its motor turns no faster than a limit, |delta'| <= rate, however far it has to go (ibid., sec. 13.3, saturation).
"""

import numpy as np

from qcar_twin.twin.engines import Array
from qcar_twin.twin.mechanisms.elements import second_order


def transition(lag: Array, inertia: Array, step: float) -> Array:
  """a, b, c, d over one step, (4, N): with e = delta - u and w = tau delta', e+ = a e + b w and w+ = c e + d w.

  Args:
    lag: tau, s, (N,).  inertia: q, (N,).  step: s.
  """
  exact = second_order(lag, inertia, step)
  out = np.stack([exact[name] for name in "abcd"])
  first_order = inertia <= 0.0
  out[:, first_order] = 0.0
  out[0, first_order] = np.exp(-step / np.maximum(lag[first_order], 1e-9))
  return out


def most_moved(rate: Array, lag: Array, step: float) -> Array:
  """What a servo of limited rate moves in a step at most, rad, and the limit of w = tau delta', rad, (2, N).

  Args:
    rate: highest of the road wheels, rad/s, (N,); inf for none.  lag: tau, s, (N,).  step: s.
  """
  return np.stack([rate * step, rate * lag])
