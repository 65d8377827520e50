"""A floor that is not level."""

from collections.abc import Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model

# m/s^2, a stated prior: 10 mm in 4 m, the most that DIN 18202 (table 3, row 3) lets a finished floor be off
LEVEL = 0.025


class FloorSlope(Mechanism):
  """Gravity pulls along the floor, always the same way in the room.

  Equation: a = (g_x, g_y) in the world frame, g_x = g times the downhill slope along x.
  Units: m/s^2, positive downhill along +x and +y; 0.1 is a slope of 1 %. The IMU shows
  the motion less this pull (specific force).
  Source: Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, sec. 4.1 (grade) and 2.7 (bank).
  Size: stated prior: 0.2 m/s^2 is 2 %, the fall of a floor with a drain; eight times what DIN 18202 allows a level
    one, 10 mm in 4 m.
  Confounded with: side_force and steering_offset on one heading, accel_bias at standstill.
  """

  name = "floor_slope"
  subsystem = "ground"
  stage = "contact"
  symmetric = False
  signed = True
  fitted_rank = 12
  parameters = (
    Parameter("floor_slope_x", 0.0, -1.0, 1.0, "m/s^2", "g_x", null=0.0, typical=0.2, description="pull along x"),
    Parameter("floor_slope_y", 0.0, -1.0, 1.0, "m/s^2", "g_y", null=0.0, typical=0.2, description="pull along y"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No floor is level."""
    return {"floor_slope_x": LEVEL, "floor_slope_y": LEVEL}

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    model.set("gravity_x", model.get("gravity_x") + theta[:, 0])
    model.set("gravity_y", model.get("gravity_y") + theta[:, 1])
