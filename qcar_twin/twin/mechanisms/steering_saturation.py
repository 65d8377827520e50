"""Steering that gives up towards lock, on each side in its own way."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State

_LEAST = 1e-6  # below it a curve is a line


class SteeringSaturation(Mechanism):
  """The wheels follow small commands and answer large ones too little, left and right differently.

  Equation: delta = u f(c |u| / delta_max), f(q) = tanh(q) / q for q > 0 and q / tanh(q) for q < 0; c + c_l to the left,
  c - c_l to the right. Small commands have the gain that they have without it.
  Units: all -; c = 1 loses 24 % at full lock, c = 3 holds the wheels at a third of it, c < 0 is steeper towards lock.
  Source: Milliken and Milliken, Race Car Vehicle Dynamics, SAE, 1995, ch. 19 (steering linkage geometry).
  Size: stated prior: 1 loses 24 % at full lock, and 0.25 is a difference of a quarter of that between the sides.
  Confounded with: steering_nonlinearity; steering_gain_error and steering_asymmetry where all commands are large.
  """

  name = "steering_saturation"
  subsystem = "steering"
  stage = "command"
  link = "geometry"
  outlined_by = "steering_curve"
  open_loop = True
  symmetric = False
  signed = True
  nonlinear_response = True
  parameters = (
    Parameter("steering_saturation", 0.0, -2.0, 6.0, "-", "c", null=0.0, typical=1.0, description="curve"),
    Parameter(
      "steering_saturation_left", 0.0, -2.0, 2.0, "-", "c_l", null=0.0, typical=0.25, description="curve, left"
    ),
  )

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    angle = command[:, 1]
    side = np.where(angle >= 0.0, 1.0, -1.0)
    bent = (theta[:, 0] + side * theta[:, 1]) * np.abs(angle) / context.car.max_steering
    size = np.maximum(np.abs(bent), _LEAST)
    share = np.tanh(size) / size
    acting = command.copy()
    acting[:, 1] = angle * np.where(bent > 0.0, share, 1.0 / share)
    return acting
