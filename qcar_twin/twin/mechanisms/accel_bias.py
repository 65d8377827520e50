"""Accelerometers that do not read zero at rest, or a share too much."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Mechanism, SensorError, Track
from qcar_twin.twin.mechanisms.elements import replaced

LEANS = 0.1  # stated prior: share that gravity adds to an acceleration in a body that leans 6 degrees per g


class AccelBias(Mechanism):
  """The accelerometers read a constant, or a share, too much.

  Equation: a_x' = (1 + s_x) a_x + b_x, a_y' = (1 + s_y) a_y + b_y.
  Units: b_x, b_y m/s^2; s_x, s_y -.
  Source: El-Sheimy, Hou and Niu, IEEE Trans. Instrumentation and Measurement 57(1), 2008.
  Size: stated prior: 0.2 m/s^2 is 20 mg, within the +-50 mg of an uncalibrated MPU-6050 (InvenSense, product
    specification 3.4, 2013); 0.1 is three times its +-3 % of scale.
  Confounded with: floor_slope on one heading, a tilted IMU (which is one); s_y: gravity felt by a
    body that rolls more than the twin's.
  """

  name = "accel_bias"
  subsystem = "sensor"
  stage = "sensor"
  needs = ("accel_y",)
  symmetric = False
  signed = True
  # not read at rest: there the floor's slope shows as well
  sensor_errors = {"accel_bias_x": SensorError(0.15), "accel_bias_y": SensorError(0.15)}
  fitted_rank = 3
  parameters = (
    Parameter("accel_bias_x", 0.0, -1.5, 1.5, "m/s^2", "b_x", null=0.0, typical=0.2, description="forward"),
    Parameter("accel_bias_y", 0.0, -1.5, 1.5, "m/s^2", "b_y", null=0.0, typical=0.2, description="left"),
    Parameter("accel_scale_x", 0.0, -0.9, 1.0, "-", "s_x", null=0.0, typical=0.1, description="share, forward"),
    Parameter("accel_scale_y", 0.0, -0.9, 1.0, "-", "s_y", null=0.0, typical=0.1, description="share, left"),
  )

  def measure(self, theta: Array, track: Track) -> Array:
    bias_x, bias_y, scale_x, scale_y = (theta[:, i : i + 1] for i in range(4))
    ahead, left = (1.0 + scale_x) * track.signal("accel_x"), (1.0 + scale_y) * track.signal("accel_y")
    return replaced(track, accel_x=ahead + bias_x, accel_y=left + bias_y)

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Of the scale: data sheets allow 1 to 3 %, and a body that leans adds its share of gravity."""
    usual = float(np.hypot(0.03 / 2.0, LEANS / 3.0))
    return {"accel_scale_x": usual, "accel_scale_y": usual}
