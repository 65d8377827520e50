"""When the numbers of a semi-implicit step hold, and all of them at one time.

A step goes v' = v + h a, x' = x + h v' (semi-implicit Euler). Velocities are those of the step's end, t. Positions are
ahead of them: x' is the leapfrog's position at t + h/2, less the half step with which the run began. An acceleration
(v' - v) / h is that of the step's middle, t - h/2. Read as if all were of t, each is off by half a step: first-order
errors that differ from channel to channel.
Source: Hairer, Lubich & Wanner, Geometric Numerical Integration, 2nd ed., 2006, ch. I.1.4 (leapfrog, Euler's variants).
"""

import numpy as np
from numpy.typing import NDArray

from qcar_twin.plant import POSE, VELOCITY, YAW, YAW_RATE, signal_index

Array = NDArray[np.float64]

_CACHED = 30_000  # numbers that a processor keeps at hand while they are rearranged
_ACCELERATION = slice(signal_index("accel_x"), signal_index("accel_y") + 1)


def at_one_time(signals: Array, step: float, period: float) -> Array:
  """Signals (N, T + 1, 10) of a simulation, all of them at the times of the grid; changed in place.

  Positions go back by the half step of which they are ahead of the run's beginning: x - h/2 (v - v_0). Accelerations go
  on to the grid's time along the line to the next reading; after the last there is none.

  Args:
    signals: in the order of SIGNALS, one row per control period.
    step: of the simulation, s.
    period: between the rows, s.
  """
  half = 0.5 * step
  yaw, velocity = signals[..., YAW], signals[..., VELOCITY]
  pace = np.empty((*signals.shape[:-1], 3))
  cosine, sine = np.cos(yaw), np.sin(yaw)
  pace[..., 0] = cosine * velocity[..., 0] - sine * velocity[..., 1]
  pace[..., 1] = sine * velocity[..., 0] + cosine * velocity[..., 1]
  pace[..., 2] = signals[..., YAW_RATE]
  signals[..., POSE] -= half * (pace - pace[:, :1])
  felt = signals[..., _ACCELERATION]
  felt[:, :-1] += half / period * (felt[:, 1:] - felt[:, :-1])
  return signals


def in_pieces(signals: Array) -> Array:
  """The same signals (N, ..., 10), each in one piece of memory: sensors and residuals read one at a time."""
  out = np.empty((signals.shape[-1], *signals.shape[:-1]))
  rows = max(1, _CACHED // (signals[0].size or 1)) if len(signals) else 1
  for first in range(0, len(signals), rows):
    out[:, first : first + rows] = np.moveaxis(signals[first : first + rows], -1, 0)
  return np.moveaxis(out, 0, -1)


def rows_of(signals: Array, rows: NDArray[np.intp]) -> Array:
  """Rows of signals (N, ..., 10), a copy, each signal in one piece of memory."""
  return np.moveaxis(np.take(np.moveaxis(signals, -1, 0), rows, axis=1), 0, -1)
