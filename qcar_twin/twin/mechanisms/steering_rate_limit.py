"""Steering servo with a top speed."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model
from qcar_twin.vehicle.similarity import Similarity

# s/rad, three deviations: a standard servo takes 0.23 s for 60 degrees at 4.8 V without a load and goes 45 degrees to
# each side (Futaba S3003, data sheet), where road wheels go 25: 0.22 s/rad of its own, 0.4 of theirs, and 0.6 under a
# third of its stalling torque, since a motor's speed falls in proportion to its load
_USUAL = 0.6
_FAST = 0.15  # s/rad, where a search begins: small servos take 0.1 to 0.16 s for 60 degrees, as far as road wheels turn


class SteeringRateLimit(Mechanism):
  """The steering moves no faster than the servo can turn.

  Equation: |delta'| <= 1 / q, of the servo's own motion: where it has far to go it runs at that rate, and near its goal
  it follows its lag.
  Units: q s/rad (0.2 is a limit of 5 rad/s, 0 is no limit), delta rad.
  Source: Franklin, Powell and Workman, Digital Control of Dynamic Systems, 3rd ed., 1998, sec. 13.3 (saturation).
  Size: stated prior: 0.8 s/rad is a standard servo (0.4 of the road wheels at 4.8 V: Futaba S3003, data sheet) that a
    load slows down to half its speed.
  Confounded with: steering_lag; it grows with the size of a step where a lag does not.
  """

  name = "steering_rate_limit"
  subsystem = "steering"
  stage = "contact"
  nonlinear_response = True
  sought_far = True
  from_threshold = True
  fitted_rank = 10
  parameters = (
    Parameter(
      "steering_inverse_rate", 0.0, 0.0, 2.0, "s/rad", "q", null=0.0, typical=0.8, start=_FAST,
      description="1 / highest rate",
    ),
  )  # fmt: skip

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    before, q = model.get("servo_rate"), theta[:, 0]
    model.set("servo_rate", np.minimum(before, np.divide(1.0, q, out=np.full_like(before, np.inf), where=q > 0.0)))

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No servo is without a limit: a usual one is three deviations. A large car's are slower by its similarity."""
    return {"steering_inverse_rate": _USUAL / 3.0 * Similarity.of(car.wheelbase).time}
