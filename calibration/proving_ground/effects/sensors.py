"""Effects of sensors and clocks."""

from __future__ import annotations

from .base import Effect


class GyroScale(Effect):
  """The gyro reads too much, or too little."""

  id, subsystem, parameter, typical, unit, signed = "gyro_scale", "sensor", "scale_error", 0.05, "-", True

  def prepare(self, car):
    car.gyro_gain[self.columns] += self.value


class PoseLatency(Effect):
  """The pose is of a moment ago."""

  id, subsystem, parameter, typical, unit = "pose_latency", "sensor", "delay", 0.055, "s"

  def prepare(self, car):
    car.pose_delay[self.columns] += self.value


class ImuLatency(Effect):
  """Accelerometer and gyro are of a moment ago."""

  id, subsystem, parameter, typical, unit = "imu_latency", "sensor", "delay", 0.055, "s"

  def prepare(self, car):
    car.imu_delay[self.columns] += self.value
