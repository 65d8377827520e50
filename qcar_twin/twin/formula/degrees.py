"""Where a force without a name may act: on the body, by the motor or the wheels' angle, or in a sensor's reading."""

import dataclasses
from collections.abc import Callable

from qcar_twin.kinematics import rolling_radius
from qcar_twin.plant import SIGNALS
from qcar_twin.twin.mechanisms.base import CarDimensions, Stage, Subsystem
from qcar_twin.vehicle.vehicle import GRAVITY


@dataclasses.dataclass(frozen=True)
class Degree:
  """One place where it may act.

  Attributes:
    words: what a report calls it.
    symbol: in an equation.
    unit: SI.
    subsystem, stage: of a mechanism that acts there.
    scale: its natural size for a car, in its unit: of a force the weight.
    signal: sensors only: what is read wrongly.
  """

  words: str
  symbol: str
  unit: str
  subsystem: Subsystem
  stage: Stage
  scale: Callable[[CarDimensions], float]
  signal: str = ""

  @property
  def units(self) -> dict[str, int]:
    """The unit as powers, by name."""
    return {"rad/s": {"rad": 1, "s": -1}, "m/s^2": {"m": 1, "s": -2}, "N m": {"N": 1, "m": 1}}.get(
      self.unit, {self.unit: 1}
    )

  @property
  def fades(self) -> bool:
    """Whether it vanishes at rest: what pushes a standing car would set it off."""
    return self.stage != "sensor" and self.unit != "rad"


def _weight(car: CarDimensions) -> float:
  return car.mass * GRAVITY


def _reading(signal: str, words: str, unit: str, size: float) -> Degree:
  assert signal in SIGNALS
  return Degree(f"the reading of {words}", f"d_{signal}", unit, "sensor", "sensor", lambda car: size, signal)


DEGREES: dict[str, Degree] = {
  "force_x": Degree("a force along the car", "F_x", "N", "body", "force", _weight),
  "force_y": Degree("a force across the car", "F_y", "N", "body", "force", _weight),
  "moment_z": Degree("a yaw moment", "M_z", "N m", "body", "force", lambda car: _weight(car) * car.wheelbase),
  "motor_torque": Degree("a torque of the motor", "T", "N m", "drive", "actuator",
                         lambda car: _weight(car) * rolling_radius(car)),
  "steering_angle": Degree("the road wheels' angle", "delta", "rad", "steering", "actuator",
                           lambda car: car.max_steering),
  "reads_yaw_rate": _reading("yaw_rate", "yaw rate", "rad/s", 6.0),
  "reads_accel_x": _reading("accel_x", "longitudinal acceleration", "m/s^2", GRAVITY),
  "reads_accel_y": _reading("accel_y", "lateral acceleration", "m/s^2", GRAVITY),
  "reads_motor_speed": _reading("motor_speed", "motor speed", "rad/s", 300.0),
}  # fmt: skip
BODY = ("force_x", "force_y", "moment_z")
