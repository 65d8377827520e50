"""IMU mounted elsewhere than the drawing says."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Mechanism, Track
from qcar_twin.twin.mechanisms.elements import replaced

_UNSAID = 0.1  # of the wheelbase, a standard deviation: a board is near the middle of its car


class ImuLeverArm(Mechanism):
  """The IMU sits off its stated place and feels the car's rotation there.

  Equation: a_x' = a_x - r^2 l_x - r' l_y, a_y' = a_y + r' l_x - r^2 l_y.
  Units: l_x, l_y m from the stated place, forward and left; r rad/s.
  Source: Titterton and Weston, Strapdown Inertial Navigation Technology, 2nd ed., 2004, ch. 4 (size effect).
  Size: stated prior: 0.05 m is a fifth of the wheelbase of 0.256 m, a board on the other deck or a place measured
    from something else.
  Confounded with: position of the centre of gravity, yaw inertia, imu_misalignment.
  """

  name = "imu_lever_arm"
  subsystem = "sensor"
  stage = "sensor"
  link = "mount"
  needs = ("accel_y",)
  symmetric = False
  signed = True
  fitted_rank = 2
  parameters = (
    Parameter("imu_lever_arm_x", 0.0, -0.25, 0.25, "m", "l_x", null=0.0, typical=0.05, description="extra, forward"),
    Parameter("imu_lever_arm_y", 0.0, -0.25, 0.25, "m", "l_y", null=0.0, typical=0.05, description="extra, left"),
  )

  def measure(self, theta: Array, track: Track) -> Array:
    rate = track.signal("yaw_rate")
    turn = np.gradient(rate, track.period, axis=1) if rate.shape[1] > 1 else rate * 0.0
    square, ahead, aside = rate * rate, theta[:, :1], theta[:, 1:]
    return replaced(
      track,
      accel_x=track.signal("accel_x") - square * ahead - turn * aside,
      accel_y=track.signal("accel_y") + turn * ahead - square * aside,
    )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """As its place was measured; where nobody says how well, a tenth of the wheelbase."""
    unsaid = _UNSAID * car.wheelbase
    return {f"imu_lever_arm_{axis}": std.get(f"imu_{axis}") or unsaid for axis in ("x", "y")}
