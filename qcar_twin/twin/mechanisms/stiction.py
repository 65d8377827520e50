"""Friction that is higher at crawling speed."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import rolling_torque


class Stiction(Mechanism):
  """Breaking away takes more force than keeping going (Stribeck effect).

  Equation: F_x = -sgn(v) F_s exp(-(v / v_s)^2), with v the rolling speed of the wheels.
  Units: F_s N at the wheels, on top of the fitted friction; v_s m/s.
  Source: Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30(7), 1994.
  Size: stated prior: 0.7 N is a quarter of the QCar's rolling friction, 2.7 N at the wheels (assets/qcar.toml).
  Confounded with: drive_dead_zone, coulomb_friction where the car never crawls.
  """

  name = "stiction"
  subsystem = "drive"
  stage = "contact"
  dissipative = True
  varies = True
  parameters = (
    Parameter("stiction_force", 0.0, 0.0, 4.0, "N", "F_s", null=0.0, typical=0.7, description="extra force at rest"),
    Parameter("stribeck_speed", 0.15, 0.03, 0.6, "m/s", "v_s", description="speed over which it fades"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    speed = rolling_torque(context.signal("motor_speed"), context)  # rad/s r_w G = m/s
    force = theta[:, 0] * np.exp(-((speed / theta[:, 1]) ** 2))
    model.set("driveline_friction", model.get("driveline_friction") + rolling_torque(force, context))
