"""Torque that ripples with the angle of the drive."""

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State


class Cogging(Mechanism):
  """The drive pulls unevenly round a turn: cogging, an eccentric gear, a bent shaft.

  Equation: V = u + A sin(n theta) + B cos(n theta), averaged over the period, theta the wheels' angle since the
  recording's start, measured by the encoder where one was logged.
  Units: A, B V (torque over torque per volt), theta rad, n per turn of the wheels. n is what the sample rate can show:
  the motor's own poles come round faster than that above a crawl.
  Source: Hanselman, Brushless Permanent Magnet Motor Design, 2nd ed., 2003, ch. 8.
  Size: stated prior: 0.15 V is half of the 0.31 V that the QCar's friction takes (assets/qcar.toml).
  Confounded with: noise of the encoder, stiction at a crawl. Recordings share A and B only if the drive stands at the
    same angle when each begins; else they cancel. Without an encoder the phase is lost from segment to segment.
  """

  name = "cogging"
  subsystem = "drive"
  stage = "actuator"
  link = "motion"
  drives = ("voltage", "duty")
  needs = ("motor_speed",)
  signed = True
  parameters = (
    Parameter("cogging", 0.0, -1.0, 1.0, "V", "A", null=0.0, typical=0.15, description="sine part"),
    Parameter("cogging_cosine", 0.0, -1.0, 1.0, "V", "B", null=0.0, typical=0.15, description="cosine part"),
    # the phase at the end of a recording of N turns is 2 pi N n: over 20 turns the cost has a minimum every 0.05 in n
    Parameter("cogging_order", 1.0, 0.2, 12.0, "-", "n", description="periods per turn of the wheels", step=0.05),
  )

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """Whole orders: what is fixed to the wheels' shaft, as a gear, meets the same place once a turn."""
    return tuple({"cogging_order": float(order)} for order in range(1, 7))

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    turn = theta[:, 2] * context.signal("motor_speed") * (context.car.gear_ratio * context.period)
    middle = theta[:, 2] * context.wheel_angle + 0.5 * turn
    ripple = theta[:, 0] * np.sin(middle) + theta[:, 1] * np.cos(middle)
    acting = command.copy()
    acting[:, 0] += ripple * np.sinc(turn / (2.0 * np.pi))
    return acting
