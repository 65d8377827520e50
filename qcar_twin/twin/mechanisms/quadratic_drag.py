"""Drag that grows with the square of the speed."""

from collections.abc import Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions
from qcar_twin.twin.mechanisms.by_motion import Resisting
from qcar_twin.vehicle.similarity import Similarity

_AIR = 0.03  # kg/m: half the density of air, a drag coefficient of 1 and 0.05 m^2, a body 0.2 m wide and 0.25 m high


class QuadraticDrag(Resisting):
  """A force against the motion that grows with the square of the speed.

  Equation: F = -c_2 |v| v, in the plane.
  Units: c_2 kg/m, F N. Air drag of a body this size is 0.01 to 0.03 kg/m; the rest is tyre and gear churn.
  Source: Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, sec. 4.1.1.
  Size: stated prior: 0.4 kg/m is 0.9 N at 1.5 m/s, 3 % of the weight of 2.7 kg; twenty times the air's share.
  Confounded with: motor damping (linear in v), battery_sag.
  """

  name = "quadratic_drag"
  subsystem = "drive"
  stage = "force"
  outlined_by = "resistance_curve"
  dissipative = True
  fitted_rank = 33
  parameters = (
    Parameter("quadratic_drag", 0.0, 0.0, 2.0, "kg/m", "c_2", null=0.0, typical=0.4, description="force per v^2"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No car drives without air: what a bluff body of its size meets is three deviations."""
    return {"quadratic_drag": _AIR / 3.0 * Similarity.of(car.wheelbase).length ** 2}

  def drag(self, theta: Array) -> Array:
    return theta[:, 0]
