"""IMU mounted at an angle."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Mechanism, Track
from qcar_twin.twin.mechanisms.elements import replaced

_SCREWED = 0.03  # rad, three deviations: two screws of 2.5 mm in holes of 3 mm, 17 mm apart


class ImuMisalignment(Mechanism):
  """The IMU is turned about the vertical, so each accelerometer feels some of the other's axis.

  Equation: a_x' = a_x cos e + a_y sin e, a_y' = a_y cos e - a_x sin e.
  Units: e rad, the IMU's own yaw on the car, counter-clockwise.
  Source: Titterton and Weston, Strapdown Inertial Navigation Technology, 2nd ed., 2004, ch. 8 (mounting errors).
  Size: stated prior: 0.09 rad is 5 deg, a board that was stuck on by eye.
  Confounded with: accel_bias, floor_slope, imu_lever_arm.
  """

  name = "imu_misalignment"
  subsystem = "sensor"
  stage = "sensor"
  link = "axes"
  needs = ("accel_y",)
  symmetric = False
  signed = True
  fitted_rank = 31
  parameters = (
    Parameter("imu_misalignment", 0.0, -0.5, 0.5, "rad", "e", null=0.0, typical=0.09, description="yaw of the IMU"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No board is screwed on squarely: what the holes allow is three deviations."""
    return {"imu_misalignment": _SCREWED / 3.0}

  def measure(self, theta: Array, track: Track) -> Array:
    cosine, sine = np.cos(theta[:, :1]), np.sin(theta[:, :1])
    ahead, aside = track.signal("accel_x"), track.signal("accel_y")
    return replaced(track, accel_x=cosine * ahead + sine * aside, accel_y=cosine * aside - sine * ahead)
