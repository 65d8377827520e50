"""Pose sensor mounted elsewhere than stated."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Mechanism, Track
from qcar_twin.twin.mechanisms.elements import replaced
from qcar_twin.vehicle.similarity import Similarity


class PoseMount(Mechanism):
  """The tracked point or the lidar is turned and shifted against the car.

  Equation: yaw' = yaw + y_0, (x', y') = (x, y) + R(yaw) (l_x, l_y).
  Units: y_0 rad counter-clockwise; l_x, l_y m forward and left of the stated point.
  Source: Censi, Franchi, Marchionni and Oriolo, IEEE T-RO 29(2), 2013 (odometry and sensor calibration).
  Size: stated prior: 0.035 rad is 2 deg, a sensor aligned by eye; 0.03 m is one measured to its housing.
  Confounded with: sideslip, wheel_radius_error on open tracks, pose_latency at constant speed.
  """

  name = "pose_mount"
  subsystem = "sensor"
  stage = "sensor"
  link = "mount"
  needs = ("pose_x",)
  symmetric = False
  signed = True
  fitted_rank = 8
  parameters = (
    Parameter("pose_mount_yaw", 0.0, -0.3, 0.3, "rad", "y_0", null=0.0, typical=0.035, description="turned by"),
    Parameter("pose_mount_x", 0.0, -0.2, 0.2, "m", "l_x", null=0.0, typical=0.03, description="shifted forward"),
    Parameter("pose_mount_y", 0.0, -0.2, 0.2, "m", "l_y", null=0.0, typical=0.03, description="shifted left"),
  )

  def measure(self, theta: Array, track: Track) -> Array:
    yaw, ahead, left = track.signal("pose_yaw"), theta[:, 1:2], theta[:, 2:]
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return replaced(
      track,
      pose_x=track.signal("pose_x") + cosine * ahead - sine * left,
      pose_y=track.signal("pose_y") + sine * ahead + cosine * left,
      pose_yaw=yaw + theta[:, :1],
    )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Of a marker's place, m, and of the direction it is stuck on in, rad."""
    place = 0.0035 * Similarity.of(car.wheelbase).length
    return {"pose_mount_x": place, "pose_mount_y": place, "pose_mount_yaw": 0.004}
