"""Steering gain that changes towards lock."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State


class SteeringNonlinearity(Mechanism):
  """Large steering commands turn the wheels by less than small ones, in proportion.

  Equation: delta = u (1 - x |u / delta_max|^p).
  Units: x - (share lost at full lock), p -; p = 2 is the cubic of a crank or the start of a tanh.
  Source: Milliken and Milliken, Race Car Vehicle Dynamics, SAE, 1995, ch. 19 (steering linkage geometry).
  Size: stated prior: 0.1 is a crank turned by 45 deg, 1 - sin(0.785) / 0.785.
  Confounded with: tyre_saturation at speed, steering_gain_error where all commands are large.
  """

  name = "steering_nonlinearity"
  subsystem = "steering"
  stage = "command"
  link = "geometry"
  outlined_by = "steering_curve"
  open_loop = True
  signed = True
  fitted_rank = 6
  parameters = (
    Parameter("steering_nonlinearity", 0.0, -0.5, 0.5, "-", "x", null=0.0, typical=0.1, description="loss at lock"),
    Parameter("steering_nonlinearity_power", 2.0, 1.0, 5.0, "-", "p", description="power of the relative angle"),
  )

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    relative = np.abs(command[:, 1]) / context.car.max_steering
    acting[:, 1] *= 1.0 - theta[:, 0] * np.minimum(relative, 1.5) ** theta[:, 1]
    return acting

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """At lock: Ackermann's geometry and a parabola for it differ by 1.5 % at 0.4 rad."""
    return {"steering_nonlinearity": 0.015}
