"""A constant force on the body: what process noise is made of, as a mechanism, so that a twin can be asked about it."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State

FORCES = ("body_force_x", "body_force_y", "body_moment")


class BodyForce(Mechanism):
  """A force and a yaw moment on the body at its centre of gravity.

  Equation: F_x, F_y, M_z constant in the body frame.
  Units: N, N, N m; forward, left, counter-clockwise.
  Source: none; it stands for what road, draught and unmodelled physics do within a window.
  Confounded with: everything.
  """

  name = "body_force"
  subsystem = "body"
  stage = "force"
  symmetric = False
  signed = True
  parameters = (
    Parameter("body_force_x", 0.0, -1e3, 1e3, "N", "F_x", null=0.0, typical=0.1, description="forward"),
    Parameter("body_force_y", 0.0, -1e3, 1e3, "N", "F_y", null=0.0, typical=0.1, description="left"),
    Parameter("body_moment", 0.0, -1e3, 1e3, "N m", "M_z", null=0.0, typical=0.01, description="counter-clockwise"),
  )

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    return theta.copy()
