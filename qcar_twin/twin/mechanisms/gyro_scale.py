"""Gyro that reads too much or too little."""

from collections.abc import Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Mechanism, Track
from qcar_twin.twin.mechanisms.elements import replaced

_DATA_SHEET = 0.03  # InvenSense MPU-6050, product specification 3.4, 2013, at 25 degrees C


class GyroScale(Mechanism):
  """The gyro reads a fixed share more than the car turns.

  Equation: yaw_rate_measured = (1 + s) yaw_rate.
  Units: s -.
  Source: Titterton and Weston, Strapdown Inertial Navigation Technology, 2nd ed., 2004, ch. 4.
  Size: stated prior: 0.05 lies beyond the +-3 % of scale of an MPU-6050 (InvenSense, product specification 3.4,
    2013).
  Confounded with: steering_gain_error where no pose was recorded.
  """

  name = "gyro_scale"
  subsystem = "sensor"
  stage = "sensor"
  link = "scale"
  needs = ("yaw_rate",)
  signed = True
  fitted_rank = 30
  parameters = (
    Parameter("gyro_scale", 0.0, -0.3, 0.3, "-", "s", null=0.0, typical=0.05, description="relative scale error"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """What a data sheet allows is three deviations."""
    return {"gyro_scale": _DATA_SHEET / 3.0}

  def measure(self, theta: Array, track: Track) -> Array:
    return replaced(track, yaw_rate=track.signal("yaw_rate") * (1.0 + theta[:, :1]))
