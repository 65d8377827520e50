"""Dry friction in the drive and the wheels."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import rolling_torque


class CoulombFriction(Mechanism):
  """A constant force against the rolling of the wheels.

  Equation: F_x = -F_c sgn(v), as motor-side friction F_c r_w G in the simulator's implicit friction.
  Units: F_c N at the wheels; it adds to the fitted friction, which never falls below zero.
  Source: Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, sec. 4.1.4 (rolling resistance).
  Size: 1 N is 4 % of the weight of 2.7 kg, the upper end of the 0.01 to 0.04 that Rajamani, sec. 4.1.4, gives for
    rolling resistance.
  Confounded with: drive_dead_zone (gone when coasting), payload, the fitted driveline friction itself:
  only that one's prior tells them apart.
  """

  name = "coulomb_friction"
  subsystem = "drive"
  stage = "contact"
  dissipative = True
  signed = True
  parameters = (
    Parameter("coulomb_friction", 0.0, -2.0, 5.0, "N", "F_c", null=0.0, typical=1.0, description="force at the wheels"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    friction = model.get("driveline_friction") + rolling_torque(theta[:, 0], context)
    model.set("driveline_friction", np.maximum(friction, 0.0))
