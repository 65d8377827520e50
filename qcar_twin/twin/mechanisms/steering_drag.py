"""Resistance that grows with the steering angle."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import rolling_torque, smooth_abs

CORNER = 0.02  # of tan(delta)


class SteeringDrag(Mechanism):
  """Steered wheels resist: bent shafts, joints at an angle, tyres scrubbing.

  Equation: F_x = -sgn(v) c |tan delta|^p, as friction of the driveline.
  Units: c N at the wheels at tan(delta) = 1, p -; the tyres' own F_yf sin(delta) is in the twin already.
  Source: Milliken and Milliken, Race Car Vehicle Dynamics, SAE, 1995, ch. 2 (induced drag of steered tyres).
  Size: stated prior: 2 N is 1.2 N at a lock of 30 deg, 4 % of the weight of 2.7 kg.
  Confounded with: differential_lock, tyre force along the car F_yf sin(delta).
  """

  name = "steering_drag"
  subsystem = "drive"
  stage = "contact"
  dissipative = True
  varies = True
  parameters = (
    Parameter("steering_drag", 0.0, 0.0, 10.0, "N", "c", null=0.0, typical=2.0, description="at tan(delta) = 1"),
    Parameter("steering_drag_power", 1.0, 1.0, 3.0, "-", "p", description="power of tan(delta)"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    bend = smooth_abs(np.tan(np.clip(context.signal("steering_angle"), -1.2, 1.2)), CORNER)
    force = theta[:, 0] * bend ** theta[:, 1]
    model.set("driveline_friction", model.get("driveline_friction") + rolling_torque(force, context))
