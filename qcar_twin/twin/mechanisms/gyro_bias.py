"""Gyro that does not read zero at rest."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Mechanism, SensorError, Track
from qcar_twin.twin.mechanisms.elements import replaced


class GyroBias(Mechanism):
  """The gyro reads a constant too much.

  Equation: yaw_rate' = yaw_rate + b.
  Units: b rad/s.
  Source: El-Sheimy, Hou and Niu, IEEE Trans. Instrumentation and Measurement 57(1), 2008.
  Size: stated prior: 0.03 rad/s, one and a half deviations of what every fit allows (`sensor_errors`); uncalibrated,
    an MPU-6050 (InvenSense, product specification 3.4, 2013) may have ten times that.
  Confounded with: steering_offset where no pose was recorded.
  """

  name = "gyro_bias"
  subsystem = "sensor"
  stage = "sensor"
  needs = ("yaw_rate",)
  symmetric = False
  signed = True
  # a gyro does not turn at rest, whatever else is wrong with the twin; it wanders with warmth and shaking
  sensor_errors = {"gyro_bias": SensorError(0.02, read_at_rest="yaw_rate", wander=0.002)}
  fitted_rank = 4
  parameters = (Parameter("gyro_bias", 0.0, -0.3, 0.3, "rad/s", "b", null=0.0, typical=0.03, description="constant"),)

  def measure(self, theta: Array, track: Track) -> Array:
    return replaced(track, yaw_rate=track.signal("yaw_rate") + theta[:, :1])
