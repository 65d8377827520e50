"""Angles, derivatives and integrals of signals under the names that scripts import."""

import math
from collections.abc import Generator
from typing import Any

import numpy as np

TWO_PI = math.tau


def wrap_to_pi(angle: Any) -> Any:
  """Angle within half a turn, rad."""
  return np.mod(np.asarray(angle) + math.pi, math.tau)[()] - math.pi


def wrap_to_2pi(angle: Any) -> Any:
  """Angle within a turn from 0, rad."""
  return np.mod(angle, math.tau)


class Calculus:
  """Derivatives and integrals of one signal each: `next` once, then `send` a sample and have the result.

  The variable ones are sent a sample and the time since the last one, s.
  """

  def differentiator(self, dt: float, x0: float = 0) -> Generator[float, float, None]:
    """Backward difference over `dt` s."""
    return _fixed(self.differentiator_variable(dt, x0), dt)

  def differentiator_variable(self, dt: float, x0: float = 0) -> Generator[float, tuple[float, float], None]:
    """Backward difference over the time that is sent with the sample; `dt` only stands for the interface."""
    slope, last = 0.0, x0
    while True:
      sample, step = yield slope
      slope, last = (sample - last) / step, sample

  def integrator(self, dt: float, integrand: float = 0) -> Generator[float, float, None]:
    """Sum of samples times `dt` s, from a first value."""
    return _fixed(self.integrator_variable(dt, integrand), dt)

  def integrator_variable(self, dt: float, integrand: float = 0) -> Generator[float, tuple[float, float], None]:
    """Sum of samples times the time that is sent with each; `dt` only stands for the interface."""
    total = float(integrand)
    while True:
      sample, step = yield total
      total += sample * step


def _fixed(variable: Generator[float, tuple[float, float], None], dt: float) -> Generator[float, float, None]:
  result = next(variable)
  while True:
    sample = yield result
    result = variable.send((sample, dt))
