"""Steering servo that moves in jerks."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State


class SteeringQuantisation(Mechanism):
  """The servo holds its angle until the command has moved away by more than its dead band.

  Equation: delta+ = delta + (u - delta) / (1 + (b / |u - delta|)^p): a hold below b, a jump to u above.
  Units: b rad; p -, how suddenly the hold gives way. A fit finds b far more easily from a soft hold (10)
  than from a hard one (80), whose misfit is a needle.
  Source: Widrow and Kollar, Quantization Noise, Cambridge, 2008, ch. 1; dead band of RC servos.
  Size: stated prior: 0.013 rad is a dead band of 8 us where 1000 us of pulse turn 90 deg.
  Confounded with: steering_backlash, steering_dead_zone.
  """

  name = "steering_quantisation"
  subsystem = "steering"
  stage = "command"
  link = "arrival"
  open_loop = True
  parameters = (
    Parameter("steering_dead_band", 0.0, 0.0, 0.08, "rad", "b", null=0.0, typical=0.013, description="held change"),
    Parameter("steering_dead_band_sharpness", 12.0, 4.0, 80.0, "-", "p", description="suddenness of the release"),
  )

  def initial(self, theta: Array, context: Context) -> State:
    return {"angle": context.signal("steering_angle").copy()}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    change = command[:, 1] - state["angle"]
    ratio = np.maximum(np.abs(change), 1e-12) / np.maximum(theta[:, 0], 1e-9)
    exponent = np.clip(theta[:, 1] * np.log(ratio), -200.0, 200.0)
    state["angle"] = state["angle"] + change / (1.0 + np.exp(-exponent))
    acting[:, 1] = state["angle"]
    return acting
