"""Formulas to try."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.formula import Formula, Law, Table
from qcar_twin.twin.formula.mechanism import made
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

RANGES = {"yaw_rate": (-2.0, 3.0), "speed": (-1.0, 2.5)}


def parameter(name: str, unit: str = "N", typical: float = 1.0) -> Parameter:
  return Parameter(name, 0.0, -9.0, 9.0, unit, "c", null=0.0, std=2.0 * typical, typical=typical)


def yaw_drag() -> Formula:
  law = Law("force_x", ("abs(yaw_rate) * sign(speed)",), RANGES, 3.9)
  return made("unnamed_force_x", law, [parameter("unnamed_force_x_1", "N s/rad", 1.2)])


def of_one_term(degree: str, term: str, limit: float = 5.0) -> Formula:
  ranges = RANGES | {"accel_y": (-6.0, 6.0), "heading": (-3.1416, 3.1416), "slip_power_3s": (0.0, 20.0)}
  return made("found", Law(degree, (term,), ranges, limit), [parameter("found_1")])


def tabled() -> Formula:
  law = Table("force_x", {"speed": (0.0, 1.0, 2.0), "yaw_rate": (-2.0, 0.0, 2.0)}, 4.0)
  return made("unnamed_force_x", law, [parameter(f"unnamed_force_x_{k}") for k in range(1, 10)])


def twin_with(mechanism: Formula, **values: float):
  """A reduced QCar with it, and its parameters."""
  twin = Twin(Vehicle(), [mechanism], threads=1, engine="reduced")
  theta = twin.parameters.nominal
  for name, value in values.items():
    theta[twin.parameters.index(name)] = value
  return twin, theta
