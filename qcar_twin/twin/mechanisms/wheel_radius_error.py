"""Wheels of another size than stated."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.plant import START
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model, Track
from qcar_twin.twin.mechanisms.elements import replaced

# how often the radius divides what the motor's torque consists of: once as a torque, once more as it goes by the speed
_AT_THE_MOTOR = {"torque_per_volt": 1, "driveline_friction": 1, "motor_damping": 2, "driveline_damping": 2}


class WheelRadiusError(Mechanism):
  """The wheels are larger than stated, so the motor turns more slowly at the same speed.

  Equation: w = v / (G r_w (1 + e)) turns the motor, of which the encoder and a speed controller know; its torque
    a u - b w - T_c moves the car by a force 1 + e times smaller.
  Units: e -; positive for larger wheels. The simulated car keeps the stated wheels: its a and T_c are 1 / (1 + e), its
    b and other losses 1 / (1 + e)^2 times those of the motor. Inertias that turn are left as they are: they are known
    to a factor of two.
  Source: Borenstein and Feng, IEEE T-RA 12(6), 1996 (systematic odometry errors).
  Size: stated prior: 0.04 is 1.3 mm of 33 mm, a soft tyre measured without its load; the manufacturer's own two
    figures differ by 3.6 % (assets/qcar.toml).
  Confounded with: longitudinal_slip (grows with the drive), pose scale.
  """

  name = "wheel_radius_error"
  subsystem = "drive"
  stage = "sensor"
  link = "mount"
  needs = ("speed", "pose_x")
  signed = True
  of_wheels = True
  fitted_rank = 1
  parameters = (
    Parameter("wheel_radius_error", 0.0, -0.2, 0.2, "-", "e", null=0.0, typical=0.04, description="relative radius"),
  )

  def begin(self, theta: Array, start: Array, rate: Array) -> Array:
    out = start.copy()
    out[:, START.index("velocity_x")] *= 1.0 + theta[:, 0]  # the speed at the start was read off the encoder
    return out

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    larger = 1.0 + theta[:, 0]
    limit = {"max_torque": 1} if np.all(np.isfinite(context.max_torque)) else {}
    for quantity, power in (_AT_THE_MOTOR | limit).items():
      model.set(quantity, model.get(quantity) / larger**power)

  def measure(self, theta: Array, track: Track) -> Array:
    return replaced(track, motor_speed=track.signal("motor_speed") / (1.0 + theta[:, :1]))

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """As the radius was measured: 0.9 % off makes every turn 0.9 % too wide, as if the steering erred."""
    return {"wheel_radius_error": std.get("wheel_radius", 0.0) / car.wheel_radius}
