"""A driveline or a floor that holds the car back more, or less, later on."""

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import changes_tried, come, come_amid, rolling_torque


class ResistanceChange(Mechanism):
  """Rolling resistance is different later on: a tyre loses air, a gear runs dry or warm, hair winds about an axle.

  Equation: F_x = -F_d s sgn(v), s = 1 - exp(-(t / t_0)^p), t the seconds driven so far in the data set; as motor-side
    friction F_d s r_w G in the simulator's implicit friction, which never falls below zero.
  Units: F_d N at the wheels, t_0 s, p - (1 creeps in, 20 comes at t_0).
  Source: Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, sec. 4.1.4 (rolling resistance); the way in which it
    comes is that of friction_change.
  Size: 1 N is 4 % of the weight of 2.7 kg, the upper end of the 0.01 to 0.04 that Rajamani, sec. 4.1.4, gives for
    rolling resistance: one comes to be as large again.
  Confounded with: battery_discharge and motor_heating, which do nothing while the car coasts; coulomb_friction where it
    is there from the start.
  """

  name = "resistance_change"
  subsystem = "drive"
  stage = "contact"
  varies = True
  signed = True
  nonlinear_response = True
  parameters = (
    Parameter("resistance_change", 0.0, -2.0, 5.0, "N", "F_d", null=0.0, typical=1.0, description="at last"),
    Parameter("resistance_change_time", 60.0, 1.0, 3000.0, "s", "t_0", description="when it comes"),
    Parameter("resistance_change_suddenness", 3.0, 0.7, 30.0, "-", "p", description="1 gradual, 20 at once"),
  )

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """A fast and a slow drift, and steps while the car was driven."""
    return [
      {"resistance_change_time": time, "resistance_change_suddenness": sudden}
      for time, sudden in changes_tried(driving)
    ]

  def observable_share(self, values: Mapping[str, float], driving: Driving) -> float:
    return come_amid(values["resistance_change_time"], values["resistance_change_suddenness"], driving)

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    driven = context.history[:, 0] + context.time
    force = theta[:, 0] * come(driven, theta[:, 1], theta[:, 2])
    friction = model.get("driveline_friction") + rolling_torque(force, context)
    model.set("driveline_friction", np.maximum(friction, 0.0))
