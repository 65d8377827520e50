"""A wheel that is braked."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import STANDSTILL


class WheelDrag(Mechanism):
  """A wheel on one side is braked: a brake that rubs, a seized bearing, a bent shaft.

  Equation: F_x = -|d| s, M_z = (t / 2) d s, s = v_w / sqrt(v_w^2 + 0.05^2), of the side's own v_w = v_x - (+-t / 2) r.
    On which axle it is a car with free differentials does not show.
  Units: d N, positive on the left, at the wheel's rim; t m, track width; v_w m/s.
  Source: Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, sec. 8.2 (yaw moment of one wheel's brake).
  Size: stated prior: 0.8 N is 3 % of the weight of 2.7 kg, a torque of 0.026 N m on a wheel of 33 mm.
  Confounded with: side_force ahead or behind, steering_offset, driveline friction.
  """

  name = "wheel_drag"
  subsystem = "drive"
  stage = "force"
  symmetric = False
  signed = True
  dissipative = True
  parameters = (
    Parameter("wheel_drag", 0.0, -8.0, 8.0, "N", "d", null=0.0, typical=0.8, description="drag on the left"),
  )

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    size, lever = theta[:, 0], 0.5 * context.car.track_width
    own = context.signal("velocity_x") - np.sign(size) * lever * context.signal("yaw_rate")
    along = own / np.sqrt(own * own + STANDSTILL**2)
    force = np.zeros((len(theta), 3))
    force[:, 0], force[:, 2] = -np.abs(size) * along, lever * size * along
    return force
