"""Tyres that run out of grip earlier."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model


class TyreSaturation(Mechanism):
  """Tyre force bends over at smaller slip than the twin's, and its peak is lower.

  Equation: mu = mu_fitted (1 - x), C = C_twin + d_C in F = mu F_z sin(C atan(slip stiffness / (C mu F_z) slip)).
  Units: x -, d_C - (negative: rounder bend, positive: fall after the peak). Small-slip stiffness stays.
  Source: Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, ch. 4 (Magic Formula).
  Size: stated prior: 0.2 is about one deviation of the friction coefficient's prior (a factor of 1.3), 0.3 is one and
    a half of the shape's (0.2).
  Confounded with: friction_change, combined_slip, load_transfer, steering_nonlinearity at one speed.
  """

  name = "tyre_saturation"
  subsystem = "tyre"
  stage = "contact"
  signed = True
  parameters = (
    Parameter("tyre_saturation", 0.0, -1.0, 0.8, "-", "x", null=0.0, typical=0.2, description="peak friction lost"),
    Parameter("tyre_saturation_shape", 0.0, -0.6, 0.8, "-", "d_C", null=0.0, typical=0.3, description="change of C"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    friction = model.get("friction_coefficient") * np.maximum(1.0 - theta[:, :1], 0.05)
    model.set("friction_coefficient", friction)
    model.set("tyre_shape", np.clip(model.get("tyre_shape") + theta[:, 1:], 0.3, 2.0))
