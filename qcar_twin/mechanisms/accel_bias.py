"""Accelerometers that do not read zero at rest."""

from qcar_twin.mechanisms.base import Array, Mechanism, Track
from qcar_twin.mechanisms.elements import replaced
from qcar_twin.parameters import Parameter


class AccelBias(Mechanism):
  """The accelerometers read a constant too much.

  Equation: a_x' = a_x + b_x, a_y' = a_y + b_y.
  Units: b_x, b_y m/s^2.
  Source: El-Sheimy, Hou and Niu, IEEE Trans. Instrumentation and Measurement 57(1), 2008.
  Confounded with: floor_slope on one heading, a tilted IMU (which is one).
  """

  name = "accel_bias"
  subsystem = "sensor"
  stage = "sensor"
  needs = ("accel_y",)
  symmetric = False
  signed = True
  parameters = (
    Parameter("accel_bias_x", 0.0, -1.5, 1.5, "m/s^2", "b_x", null=0.0, typical=0.2, description="forward"),
    Parameter("accel_bias_y", 0.0, -1.5, 1.5, "m/s^2", "b_y", null=0.0, typical=0.2, description="left"),
  )

  def measure(self, theta: Array, track: Track) -> Array:
    ahead, left = track.signal("accel_x") + theta[:, :1], track.signal("accel_y") + theta[:, 1:]
    return replaced(track, accel_x=ahead, accel_y=left)
