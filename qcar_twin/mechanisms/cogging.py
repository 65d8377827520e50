"""Torque that ripples with the angle of the drive."""

import numpy as np

from qcar_twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.parameters import Parameter


class Cogging(Mechanism):
  """The drive pulls unevenly round a turn: cogging, an eccentric gear, a bent shaft.

  Equation: V = u + A sin(n theta) + B cos(n theta), theta the wheels' angle since the start, averaged over the period.
  Units: A, B V (torque over torque per volt), n per turn of the wheels. n is what the sample rate can show:
  the motor's own poles come round faster than that above a crawl.
  Source: Hanselman, Brushless Permanent Magnet Motor Design, 2nd ed., 2003, ch. 8.
  Confounded with: noise of the encoder, stiction at a crawl.
  """

  name = "cogging"
  subsystem = "drive"
  stage = "actuator"
  signed = True
  parameters = (
    Parameter("cogging", 0.0, -1.0, 1.0, "V", "A", null=0.0, typical=0.15, description="sine part"),
    Parameter("cogging_cosine", 0.0, -1.0, 1.0, "V", "B", null=0.0, typical=0.15, description="cosine part"),
    Parameter("cogging_order", 1.0, 0.2, 12.0, "-", "n", description="periods per turn of the wheels"),
  )

  def initial(self, theta: Array, context: Context) -> State:
    return {"angle": np.zeros(len(theta))}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    turn = theta[:, 2] * context.signal("motor_speed") * (context.car.gear_ratio * context.period)
    middle = state["angle"] + 0.5 * turn
    ripple = theta[:, 0] * np.sin(middle) + theta[:, 1] * np.cos(middle)
    acting = command.copy()
    acting[:, 0] += ripple * np.sinc(turn / (2.0 * np.pi))
    state["angle"] = state["angle"] + turn
    return acting
