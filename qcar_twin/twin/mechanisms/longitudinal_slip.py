"""Wheels that turn faster than the car moves when they drive."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model

REFERENCE_ACCELERATION = 2.0  # m/s^2: the drive at which the added slip is stated


class LongitudinalSlip(Mechanism):
  """Driving and braking wheels slip more than the fitted tyre does.

  Equation: 1 / C_x = 1 / C_x,fitted + s / F_0 per wheel, F_0 = m 2 m/s^2 / 4.
  Units: s -, slip added at a drive of 2 m/s^2; C_x N per unit slip.
  Source: Wong, Theory of Ground Vehicles, 4th ed., 2008, ch. 1 (longitudinal slip).
  Size: stated prior: 0.04 is sixteen times the slip of the nominal tyre at 2 m/s^2, 1.35 N over 540 N: wheels on
    dust.
  Confounded with: wheel_radius_error (does not change with the drive), rotor inertia.
  """

  name = "longitudinal_slip"
  subsystem = "tyre"
  stage = "contact"
  needs = ("speed", "pose_x")
  signed = True
  absorbed_by_drive = True
  parameters = (
    Parameter("longitudinal_slip", 0.0, -0.03, 0.2, "-", "s", null=0.0, typical=0.04, description="at 2 m/s^2"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    stiffness = model.get("longitudinal_stiffness")
    force = context.car.mass * REFERENCE_ACCELERATION / 4.0
    model.set("longitudinal_stiffness", stiffness / np.maximum(1.0 + theta[:, :1] * stiffness / force, 0.2))
