"""Wheel loads that shift more, or matter more, than the twin's."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model


class LoadTransfer(Mechanism):
  """The balance of the car changes with acceleration: higher centre of gravity, load-sensitive tyres.

  Equation: dF_z = m a (h + d_h) / (2 t or 2 L) per wheel; stiffness and friction per load go with F_z^-(n + d_n).
  Units: d_h m above the stated height; d_n -.
  Source: Milliken and Milliken, Race Car Vehicle Dynamics, SAE, 1995, ch. 7 and 18 (load transfer, load sensitivity).
  Size: stated prior: 0.02 m is nearly half of the height of 0.045 m, a camera or a battery on the upper deck; 0.2
    takes 6 % of the grip of a wheel whose load is a third more.
  Confounded with: combined_slip, front to rear balance of cornering stiffness.
  """

  name = "load_transfer"
  subsystem = "tyre"
  stage = "contact"
  signed = True
  fitted_rank = 9
  parameters = (
    Parameter("load_transfer", 0.0, -0.03, 0.1, "m", "d_h", null=0.0, typical=0.02, description="added CG height"),
    Parameter("load_sensitivity", 0.0, -0.4, 0.8, "-", "d_n", null=0.0, typical=0.2, description="added exponent"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    lowest = 0.01 - context.car.cg_height
    model.set("cg_height_offset", np.maximum(model.get("cg_height_offset") + theta[:, 0], lowest))
    model.set("load_exponent", model.get("load_exponent") + theta[:, 1:])

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Of the cornering stiffness' exponent, which nobody measures on such tyres."""
    return {"load_sensitivity": 0.07}
