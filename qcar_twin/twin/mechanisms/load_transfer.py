"""Wheel loads that shift more, or matter more, than the twin's."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model


class LoadTransfer(Mechanism):
  """The balance of the car changes with acceleration: higher centre of gravity, load-sensitive tyres.

  Equation: dF_z = m a (h + d_h) / (2 t or 2 L) per wheel; stiffness per load goes with F_z^-(n + d_n), friction with
    F_z^-(k + d_k).
  Units: d_h m above the stated height; d_n, d_k -.
  Source: Milliken and Milliken, Race Car Vehicle Dynamics, SAE, 1995, ch. 2, 7 and 18 (load transfer, load
    sensitivity); Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.2 (D and K each with a load of its own).
  Confounded with: combined_slip, tyre_saturation, front to rear balance of cornering stiffness.
  """

  name = "load_transfer"
  subsystem = "tyre"
  stage = "contact"
  signed = True
  fitted_rank = 9
  parameters = (
    Parameter("load_transfer", 0.0, -0.03, 0.1, "m", "d_h", null=0.0, typical=0.02, description="added CG height"),
    Parameter("load_sensitivity", 0.0, -0.4, 0.8, "-", "d_n", null=0.0, typical=0.2,
              description="added exponent of stiffness"),
    Parameter("friction_load_sensitivity", 0.0, -0.4, 0.8, "-", "d_k", null=0.0, typical=0.2,
              description="added exponent of friction"),
  )  # fmt: skip
  meant = {"friction_load_sensitivity": "load_sensitivity"}

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    lowest = 0.01 - context.car.cg_height
    model.set("cg_height_offset", np.maximum(model.get("cg_height_offset") + theta[:, 0], lowest))
    model.set("load_exponent", model.get("load_exponent") + theta[:, 1:2])
    model.set("friction_load_exponent", model.get("friction_load_exponent") + theta[:, 2:])

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Of both exponents, which nobody measures on such tyres.

    Force at the limit goes with F_z^0.7 to F_z^0.9 (Milliken, ch. 2: 1.10 at 900 lb, 0.97 at 1800 lb is F_z^0.82), so
    that friction's exponent lies 0.08 (rms) about the 0.15 of the twin where all of that is equally likely.
    """
    return {"load_sensitivity": 0.07, "friction_load_sensitivity": 0.08}
