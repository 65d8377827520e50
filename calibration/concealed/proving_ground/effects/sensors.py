"""Effects of sensors and clocks: most are columns that the sensors read by."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from .base import Effect

DEGREE = np.pi / 180


class ImuMisalignment(Effect):
  """The IMU's board is glued on askew."""

  id, subsystem, parameter, typical, unit = "imu_misalignment", "sensor", "imu_misalignment", 5 * DEGREE, "rad"
  signed = True

  def prepare(self, car: SimpleNamespace) -> None:
    car.imu_twist[self.columns] += self.value


class ImuLeverArm(Effect):
  """The IMU is not where it was measured, in a direction drawn at random; parameter: the distance."""

  id, subsystem, parameter, typical, unit = "imu_lever_arm", "sensor", "distance", 0.05, "m"

  def choose(self, rng: np.random.Generator) -> None:
    angle = rng.uniform(-np.pi, np.pi)
    self.shift = self.value * np.array([np.cos(angle), np.sin(angle)])

  def prepare(self, car: SimpleNamespace) -> None:
    car.imu_x[self.columns] += self.shift[0]
    car.imu_y[self.columns] += self.shift[1]

  def truth(self) -> dict[str, float]:
    return {"imu_lever_arm_x": float(self.shift[0]), "imu_lever_arm_y": float(self.shift[1])}


class GyroScale(Effect):
  """The gyro reads too much, or too little."""

  id, subsystem, parameter, typical, unit, signed = "gyro_scale", "sensor", "gyro_scale", 0.05, "-", True

  def prepare(self, car: SimpleNamespace) -> None:
    car.gyro_gain[self.columns] += self.value


class AccelBias(Effect):
  """The accelerometer's zero is off, in a direction drawn at random, and creeps."""

  id, subsystem, parameter, typical, unit = "accel_bias", "sensor", "accel_bias", 0.20, "m/s^2"

  def choose(self, rng: np.random.Generator) -> None:
    angle = rng.uniform(-np.pi, np.pi)
    self.bias = self.value * np.array([np.cos(angle), np.sin(angle)])

  def prepare(self, car: SimpleNamespace) -> None:
    c = self.columns
    car.accel_bias_x[c] += self.bias[0]
    car.accel_bias_y[c] += self.bias[1]
    car.bias_walk[c] += 1e-3 * self.size

  def truth(self) -> dict[str, float]:
    return {"accel_bias_x": float(self.bias[0]), "accel_bias_y": float(self.bias[1])}


class GyroBias(Effect):
  """The gyro's zero is off."""

  id, subsystem, parameter, typical, unit, signed = "gyro_bias", "sensor", "gyro_bias", 0.03, "rad/s", True

  def prepare(self, car: SimpleNamespace) -> None:
    car.gyro_bias[self.columns] += self.value


class PoseLatency(Effect):
  """The pose is of a moment ago."""

  id, subsystem, parameter, typical, unit = "pose_latency", "sensor", "pose_latency", 0.055, "s"

  def prepare(self, car: SimpleNamespace) -> None:
    car.pose_delay[self.columns] += self.value


class ImuLatency(Effect):
  """Accelerometer and gyro are of a moment ago."""

  id, subsystem, parameter, typical, unit = "imu_latency", "sensor", "imu_latency", 0.055, "s"

  def prepare(self, car: SimpleNamespace) -> None:
    car.imu_delay[self.columns] += self.value


class ClockDrift(Effect):
  """The localisation computer's clock runs slow against the log: at time t of a run its pose is of (1 - e) t."""

  id, subsystem, parameter, typical, unit, signed = "clock_drift", "sensor", "clock_drift", 0.006, "-", True

  def prepare(self, car: SimpleNamespace) -> None:
    car.pose_drift[self.columns] += self.value


class PoseMount(Effect):
  """The tracked body's frame sits askew on the car and off its centre of gravity; parameter: the yaw."""

  id, subsystem, parameter, typical, unit, signed = "pose_mount", "sensor", "pose_mount_yaw", 2 * DEGREE, "rad", True

  def choose(self, rng: np.random.Generator) -> None:
    self.arm = 0.03 * abs(self.size) * rng.uniform(-1, 1, 2)

  def prepare(self, car: SimpleNamespace) -> None:
    c = self.columns
    car.pose_turn[c] += self.value
    car.pose_ahead[c] += self.arm[0]
    car.pose_aside[c] += self.arm[1]

  def truth(self) -> dict[str, float]:
    return super().truth() | {"pose_mount_x": float(self.arm[0]), "pose_mount_y": float(self.arm[1])}
