"""Sensors on a clock that runs fast or slow."""

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Mechanism, Track
from qcar_twin.twin.mechanisms.elements import replaced, shifted

POSE = ("pose_x", "pose_y", "pose_yaw")
ONBOARD = ("yaw_rate", "accel_x", "accel_y", "motor_speed")


class ClockDrift(Mechanism):
  """The sensors' clock runs fast against that of the commands, so they seem later and later.

  Equation: y(t) = x(t - e t), t the time in the recording; the car's own sensors by the share s of it.
  Units: e - (0.001 is 1 ms per second), s - (1: pose, IMU and encoder equally, 0: the pose only).
  Source: Mills, IEEE Trans. Communications 39(10), 1991 (clock skew).
  Size: stated prior: 0.005 is the tolerance of a ceramic resonator, a hundred times that of a crystal.
  Confounded with: pose_latency and imu_latency in short recordings.
  """

  name = "clock_drift"
  subsystem = "sensor"
  stage = "sensor"
  link = "clock"
  signed = True
  parameters = (
    Parameter("clock_drift", 0.0, -0.03, 0.03, "-", "e", null=0.0, typical=0.005, description="seconds per second"),
    Parameter("clock_drift_onboard", 0.8, 0.0, 1.0, "-", "s", description="share of the car's own sensors"),
  )

  def initial_guesses(self, driving: Driving) -> tuple[dict[str, float], ...]:
    """The pose's clock alone, or all sensors' clock: a search from one hardly finds the other."""
    return {"clock_drift_onboard": 0.0}, {"clock_drift_onboard": 0.95}

  def measure(self, theta: Array, track: Track) -> Array:
    late = theta[:, :1] * track.recording_time / track.period
    onboard = late * theta[:, 1:]
    shown = {name: shifted(track.signal(name), late, extrapolate=True) for name in POSE}
    return replaced(track, **shown, **{name: shifted(track.signal(name), onboard) for name in ONBOARD})
