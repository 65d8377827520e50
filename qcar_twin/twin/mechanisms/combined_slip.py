"""Tyres that lose side force when they drive or brake."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import drive_force

REFERENCE_ACCELERATION = 2.0  # m/s^2: the drive at which the loss is stated


class CombinedSlip(Mechanism):
  """Driving and braking take side stiffness away from the tyres, beyond the twin's friction circle.

  Equation: C_y = C_y,fitted / (1 + e (F_x / (m 2 m/s^2))^2), F_x the motor's force at the wheels.
  Units: e -, share lost (to first order) at a drive of 2 m/s^2.
  Source: Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.2 (combined slip weighting).
  Size: stated prior: 0.2 is six times what the friction circle takes at 2 m/s^2 and a friction coefficient of 0.8,
    sqrt(1 - (2 / 7.8)^2) = 0.97.
  Confounded with: load_transfer, tyre_saturation.
  """

  name = "combined_slip"
  subsystem = "tyre"
  stage = "contact"
  drives = ("voltage", "duty", "current", "acceleration")
  varies = True
  parameters = (
    Parameter("combined_slip", 0.0, 0.0, 1.5, "-", "e", null=0.0, typical=0.2, description="loss at 2 m/s^2"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    relative = drive_force(context) / (context.car.mass * REFERENCE_ACCELERATION)
    loss = 1.0 + theta[:, 0] * relative * relative
    model.set("cornering_stiffness", model.get("cornering_stiffness") / loss[:, None])
