"""Steering that turns more or less than commanded."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State

_READ = 0.007  # of the angle: 0.2 degrees at 30, as a protractor reads it


class SteeringGainError(Mechanism):
  """The road wheels turn by a fixed share more or less than commanded.

  Equation: delta = (1 + k) u.
  Units: k -, delta and u rad.
  Source: Gillespie, Fundamentals of Vehicle Dynamics, SAE, 1992, ch. 8 (steering ratio).
  Size: stated prior: 0.075 is an arm of 20 mm that is 1.5 mm longer or shorter than stated.
  Confounded with: steering_nonlinearity, cornering stiffness at one speed, gyro_scale.
  """

  name = "steering_gain_error"
  subsystem = "steering"
  stage = "command"
  link = "geometry"
  outlined_by = "steering_curve"
  open_loop = True
  signed = True
  fitted_rank = 7
  parameters = (
    Parameter("steering_gain_error", 0.0, -0.4, 0.4, "-", "k", null=0.0, typical=0.075, description="relative gain"),
  )

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    acting[:, 1] *= 1.0 + theta[:, 0]
    return acting

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """As an angle is read, and what that at full lock was stated to be uncertain by: most commands are shares of it."""
    return {"steering_gain_error": float(np.hypot(_READ, std.get("max_steering", 0.0) / car.max_steering))}
