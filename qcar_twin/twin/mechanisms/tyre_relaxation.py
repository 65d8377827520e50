"""Front tyres that need another distance to build up force across than the rear ones."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model


class TyreRelaxation(Mechanism):
  """The front tyres' force across follows slip after another distance rolled than the rear tyres'.

  Equation: (sigma / v) F' + F = F_ss, sigma = max(sigma_fitted + d_sigma, 0) at the front wheels and sigma_fitted at
    the rear ones: what all four share, the base twin fits. Along, it fits a length of its own.
  Units: d_sigma m.
  Source: Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, ch. 7 (single contact point transient model: the length is
    cornering stiffness over lateral stiffness of the carcass, and both change with pressure and age).
  Size: stated prior: 0.03 m is nearly a wheel radius, where the nominal length is a third of one.
  Confounded with: steering_lag, whose delay does not shrink with speed.
  """

  name = "tyre_relaxation"
  subsystem = "tyre"
  stage = "contact"
  signed = True
  nonlinear_response = (
    True  # tyres and servo move far to make up for it, and a linear model from there predicts nothing
  )
  parameters = (
    Parameter(
      "tyre_relaxation", 0.0, -0.2, 0.4, "m", "d_sigma", null=0.0, typical=0.03, description="front minus rear"
    ),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    length = model.get("relaxation_length")
    front = np.maximum(length[:, :2] + theta[:, :1], 0.0)
    model.set("relaxation_length", np.hstack([front, length[:, 2:]]))
