"""Wheels of another size than stated."""

from collections.abc import Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.plant import START
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Mechanism, Track
from qcar_twin.twin.mechanisms.elements import replaced


class WheelRadiusError(Mechanism):
  """The wheels are larger than stated, so the motor turns more slowly at the same speed.

  Equation: omega_measured = omega / (1 + e), as omega G r_w (1 + e) = v.
  Units: e -; positive for larger wheels. The force of the drive, which changes by the same factor, is left to the
  fitted torque per volt.
  Source: Borenstein and Feng, IEEE T-RA 12(6), 1996 (systematic odometry errors).
  Size: stated prior: 0.04 is 1.3 mm of 33 mm, a soft tyre measured without its load; the manufacturer's own two
    figures differ by 3.6 % (assets/qcar.toml).
  Confounded with: longitudinal_slip (grows with the drive), pose scale.
  """

  name = "wheel_radius_error"
  subsystem = "drive"
  stage = "sensor"
  link = "mount"
  needs = ("motor_speed", "pose_x")
  signed = True
  fitted_rank = 1
  parameters = (
    Parameter("wheel_radius_error", 0.0, -0.2, 0.2, "-", "e", null=0.0, typical=0.04, description="relative radius"),
  )

  def begin(self, theta: Array, start: Array, rate: Array) -> Array:
    out = start.copy()
    out[:, START.index("velocity_x")] *= 1.0 + theta[:, 0]  # the speed at the start was read off the encoder
    return out

  def measure(self, theta: Array, track: Track) -> Array:
    return replaced(track, motor_speed=track.signal("motor_speed") / (1.0 + theta[:, :1]))

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """As the radius was measured: 0.9 % off makes every turn 0.9 % too wide, as if the steering erred."""
    return {"wheel_radius_error": std.get("wheel_radius", 0.0) / car.wheel_radius}
