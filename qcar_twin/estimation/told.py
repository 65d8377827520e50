"""What a calibrated or repaired twin tells the filter: its linkage, delays and sensors, by the twin's own names."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from qcar_twin.estimation.settings import FilterSettings

DIRECT = {  # of a twin's parameters, and of the settings
  "steering_offset": "steering_offset",
  "gyro_bias": "yaw_rate_bias",
  "accel_bias_x": "accel_x_bias",
  "accel_bias_y": "accel_y_bias",
}


def told(settings: FilterSettings, values: Mapping[str, float]) -> FilterSettings:
  """These settings with what a twin's parameters say of steering, delays and sensors.

  Lags add up; of a dead time the part that is no whole period is counted as lag, the same phase at low frequency.
  A wheel larger by e makes the encoder say 1 / (1 + e) of the speed. What the twin does not have stays as it is.

  Args:
    values: parameters by name, as of `twin.parameters.named(theta)`.
  """
  changes: dict[str, Any] = {mine: values[name] for name, mine in DIRECT.items() if name in values}
  if "servo_time_constant" in values or "steering_lag" in values:
    changes["steering_lag"] = values.get("servo_time_constant", 0.0) + values.get("steering_lag", 0.0)
  if "steering_gain_error" in values:
    changes["steering_gain"] = 1.0 + values["steering_gain_error"]
  if "wheel_radius_error" in values:
    changes["speed_scale"] = 1.0 / (1.0 + values["wheel_radius_error"])
  for axis, name in (("imu_x", "imu_lever_arm_x"), ("imu_y", "imu_lever_arm_y")):
    if name in values:
      changes[axis] = getattr(settings, axis) + values[name]
  if "drive_delay" in values:
    changes["drive_delay"] = values["drive_delay"]
  if "steering_delay" in values:
    whole = math.floor(values["steering_delay"] / settings.period + 1e-6) * settings.period
    changes["steering_delay"] = whole
    lag = changes.get("steering_lag", settings.steering_lag)
    changes["steering_lag"] = lag + max(0.0, values["steering_delay"] - whole)
  return dataclasses.replace(settings, **changes)
