"""A steady push to one side."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import STANDSTILL


class SideForce(Mechanism):
  """Rolling wheels push the car to one side: conicity, ply-steer, wheels out of true.

  Equation: F_y = F_y0 v_x^2 / (v_x^2 + 0.05^2), M_z = x_0 F_y, in the body frame.
  Units: F_y0 N, positive to the left; x_0 m, its point of action ahead of the centre of gravity.
  Source: Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3 (conicity and ply-steer).
  Size: stated prior: 0.7 N is 2.6 % of the weight of 2.7 kg, the force of 0.1 deg of slip on both axles.
  Confounded with: steering_offset, floor_slope on one heading, gyro_bias.
  """

  name = "side_force"
  subsystem = "tyre"
  stage = "force"
  symmetric = False
  signed = True
  parameters = (
    Parameter("side_force", 0.0, -3.5, 3.5, "N", "F_y0", null=0.0, typical=0.7, description="push to the left"),
    Parameter("side_force_x", 0.0, -0.15, 0.15, "m", "x_0", description="point of action ahead of the CG"),
  )

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    square = context.signal("velocity_x") ** 2
    force = np.zeros((len(theta), 3))
    force[:, 1] = theta[:, 0] * square / (square + STANDSTILL**2)
    force[:, 2] = theta[:, 1] * force[:, 1]
    return force
