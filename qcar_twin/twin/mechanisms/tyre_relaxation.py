"""Tyres that need some distance to build up force across."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model


class TyreRelaxation(Mechanism):
  """Tyre force across follows slip only after some distance rolled.

  Equation: (sigma / v) F' + F = F_ss, sigma = sigma_fitted + d_sigma, on all four wheels. Along, the base
  twin fits a length of its own.
  Units: d_sigma m.
  Source: Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, ch. 7 (single contact point transient model).
  Size: stated prior: 0.06 m is nearly two wheel radii, the order of road tyres' lengths; the nominal one is a third
    of a radius.
  Confounded with: steering_lag, whose delay does not shrink with speed.
  """

  name = "tyre_relaxation"
  subsystem = "tyre"
  stage = "contact"
  nonlinear_response = (
    True  # tyres and servo move far to make up for it, and a linear model from there predicts nothing
  )
  parameters = (
    Parameter("tyre_relaxation", 0.0, 0.0, 0.4, "m", "d_sigma", null=0.0, typical=0.06, description="added length"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    model.set("relaxation_length", np.maximum(model.get("relaxation_length") + theta[:, :1], 0.0))
