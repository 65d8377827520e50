"""Poses that arrive late."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Mechanism, SensorError, Track
from qcar_twin.twin.mechanisms.elements import caught_up, replaced, shifted


class PoseLatency(Mechanism):
  """The pose shown is where the car was a while ago (scan matching, cameras, network).

  Equation: y(t) = x(t - d) for pose_x, pose_y and pose_yaw.
  Units: d s; parts of a period are interpolated, and the first motion is continued backwards.
  Source: Furgale, Rehder and Siegwart, IROS 2013 (temporal calibration of sensors).
  Size: stated prior: 0.055 s is half a turn of a lidar at 10 Hz and half a control period of 10 ms.
  Confounded with: steering_delay together with drive_delay; pose_mount at constant speed.
  """

  name = "pose_latency"
  subsystem = "sensor"
  stage = "sensor"
  link = "clock"
  needs = ("pose_x",)
  signed = True
  sought_far = True
  sensor_errors = {"pose_latency": SensorError(0.005)}  # motion capture streams what was some milliseconds ago
  of_pose = True
  fitted_rank = 16
  parameters = (
    Parameter("pose_latency", 0.0, -0.12, 0.3, "s", "d", null=0.0, typical=0.055, description="age of the pose"),
  )

  def begin(self, theta: Array, start: Array, rate: Array) -> Array:
    return caught_up(start, rate, theta[:, 0], "velocity_x", "velocity_y", "yaw_rate")

  def measure(self, theta: Array, track: Track) -> Array:
    late = theta[:, :1] / track.period
    names = ("pose_x", "pose_y", "pose_yaw")
    return replaced(track, **{name: shifted(track.signal(name), late, extrapolate=True) for name in names})
