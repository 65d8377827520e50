"""Gyro whose zero creeps."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Mechanism, Track
from qcar_twin.twin.mechanisms.elements import replaced

SPAN = 60.0  # s over which the drift is stated


class GyroDrift(Mechanism):
  """The gyro's zero creeps from the beginning of a recording on, as it warms up.

  Equation: yaw_rate' = yaw_rate + d t / 60 s, t the time in the recording.
  Units: d rad/s per minute.
  Source: El-Sheimy, Hou and Niu, IEEE Trans. Instrumentation and Measurement 57(1), 2008.
  Size: stated prior: 0.5 rad/s/min makes 0.04 rad/s in a run of 5 s, the size of gyro_bias: less is no other than a
    constant in a short run.
  Confounded with: gyro_bias in short recordings.
  """

  name = "gyro_drift"
  subsystem = "sensor"
  stage = "sensor"
  needs = ("yaw_rate",)
  symmetric = False
  signed = True
  parameters = (
    Parameter("gyro_drift", 0.0, -2.0, 2.0, "rad/s/min", "d", null=0.0, typical=0.5, description="per minute"),
  )

  def measure(self, theta: Array, track: Track) -> Array:
    return replaced(track, yaw_rate=track.signal("yaw_rate") + theta[:, :1] * (track.recording_time / SPAN))
