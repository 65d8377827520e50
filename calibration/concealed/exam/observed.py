"""Effects on what the sensors see, of any car: signals on the fine grid in, other signals out.

Sensors read other signals than the driver's eyes: pose is x, y, yaw; the gyro yaw_rate; the encoder motor.
"""

from __future__ import annotations

import numpy as np

from ..laboratory.manoeuvres import PERIOD
from .effects import Effect, Signals
from .generator import FINE

STEP = PERIOD / FINE  # s between fine samples
IMU, ENCODER, POSE = ("accel_x", "accel_y", "yaw_rate"), ("motor",), ("x", "y", "yaw")
_MEASURED = (*IMU, *ENCODER, *POSE)


def _at(signals: Signals, names: tuple[str, ...], when: np.ndarray) -> Signals:
  """Signals as they were at other times [s]; before the start as at the start."""
  time = STEP * np.arange(len(when))
  return {**signals, **{name: np.interp(when, time, signals[name]) for name in names}}


def _clock(signals: Signals) -> np.ndarray:
  return STEP * np.arange(len(signals["x"]))


def _turned(signals: Signals, angle: float) -> Signals:
  cos, sin, x, y = np.cos(angle), np.sin(angle), signals["accel_x"], signals["accel_y"]
  return {**signals, "accel_x": cos * x + sin * y, "accel_y": cos * y - sin * x}


def _ahead(signals: Signals, place: float) -> Signals:
  """The IMU sits further forward [m]: rigid-body kinematics."""
  turn = signals["yaw_rate"]
  x, y = signals["accel_x"] - place * turn**2, signals["accel_y"] + place * np.gradient(turn, STEP)
  return {**signals, "accel_x": x, "accel_y": y}


def _scaled(signals: Signals, names: tuple[str, ...], share: float) -> Signals:
  return {**signals, **{name: (1.0 + share) * signals[name] for name in names}}


SENSOR_EFFECTS: dict[str, Effect] = {
  "imu_age": Effect(
    "sensor", "sensor", ("imu_latency",), "s", 0.3, lambda s, size: _at(s, IMU, _clock(s) - size)
  ),
  "encoder_age": Effect(
    "sensor", "sensor", ("encoder_latency",), "s", 0.3, lambda s, size: _at(s, ENCODER, _clock(s) - size)
  ),
  "pose_age": Effect(
    "sensor", "sensor", ("pose_latency",), "s", 0.5, lambda s, size: _at(s, POSE, _clock(s) - size)
  ),
  "gyro_gain": Effect(
    "sensor", "sensor", ("gyro_scale",), "-", 0.5, lambda s, size: _scaled(s, ("yaw_rate",), size), signed=True
  ),
  "gyro_creep": Effect(
    "sensor", "sensor", ("gyro_drift",), "rad/s^2", 0.3,
    lambda s, size: {**s, "yaw_rate": s["yaw_rate"] + size * _clock(s)}, signed=True,
  ),
  "imu_turned": Effect("sensor", "sensor", ("imu_misalignment",), "rad", 1.0, _turned, signed=True),
  "imu_ahead": Effect("sensor", "sensor", ("imu_lever_arm",), "m", 0.5, _ahead, signed=True),
  "accel_gain": Effect(
    "sensor", "sensor", ("accel_bias",), "-", 0.5,
    lambda s, size: _scaled(s, ("accel_x", "accel_y"), size), signed=True,
  ),
  "pose_turned": Effect(
    "sensor", "sensor", ("pose_mount",), "rad", 0.5, lambda s, size: {**s, "yaw": s["yaw"] + size}, signed=True
  ),
  "clock_drift": Effect(
    "sensor", "sensor", ("clock_drift",), "-", 0.1,
    lambda s, size: _at(s, _MEASURED, _clock(s) / (1.0 + size)), signed=True,
  ),
  "gyro_by_acceleration": Effect(
    "sensor", "sensor", (), "s/m", 0.2,
    lambda s, size: {**s, "yaw_rate": s["yaw_rate"] + size * s["accel_y"]}, signed=True,
  ),
}  # fmt: skip
