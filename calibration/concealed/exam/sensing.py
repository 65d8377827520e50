"""Sensors of the exam's cars: an IMU that averages, a speed controller's estimate of motor speed, a localisation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .effects import Signals
from .generator import FINE, SIGNALS

AVERAGED = 4  # fine steps that the IMU's low pass averages over
POSE_EVERY = 4  # ticks
NOISE = {"accel": 0.06, "gyro": 0.003, "motor": 0.6, "pose": 0.003, "heading": 0.004}  # rms; m/s^2, rad/s, rad/s, m
BIAS = {"accel": 0.03, "gyro": 0.002}  # rms of a session
DECIMALS = {
  "motor_current": 3, "steering_command": 5, "motor_speed": 2, "accel_x": 3, "accel_y": 3, "yaw_rate": 4,
  "pose_x": 4, "pose_y": 4, "pose_yaw": 4,
}  # fmt: skip


def session_bias(rng: np.random.Generator) -> dict[str, float]:
  """The IMU's offsets of a session [m/s^2, m/s^2, rad/s]."""
  sizes = {"accel_x": BIAS["accel"], "accel_y": BIAS["accel"], "yaw_rate": BIAS["gyro"]}
  return {name: size * float(rng.standard_normal()) for name, size in sizes.items()}


def as_signals(trace: np.ndarray) -> Signals:
  """Signals (M,) of a trace (M, 10), by SIGNALS."""
  return dict(zip(SIGNALS, trace.T, strict=True))


def sense(
  signal: Signals, bias: dict[str, float], noise: float, rng: np.random.Generator, rms: Mapping[str, float] = NOISE
) -> dict[str, np.ndarray]:
  """Channels (T,) of signals (FINE T + 1,); `noise` scales all that is random, `rms` by sensor."""
  grid = slice(0, len(signal["x"]) - 1, FINE)
  out = {}
  for name in bias:
    kind = "gyro" if name == "yaw_rate" else "accel"
    clean = averaged(signal[name])[grid]
    out[name] = clean + noise * (bias[name] + rms[kind] * rng.standard_normal(clean.shape))
  for name, source, kind in (
    ("motor_speed", "motor", "motor"), ("pose_x", "x", "pose"), ("pose_y", "y", "pose"), ("pose_yaw", "yaw", "heading")
  ):  # fmt: skip
    clean = signal[source][grid]
    out[name] = clean + noise * rms[kind] * rng.standard_normal(clean.shape)
  return out


def averaged(values: np.ndarray) -> np.ndarray:
  """Mean of the last AVERAGED fine steps; before the start the first value."""
  padded = np.concatenate([np.full(AVERAGED - 1, values[0]), values])
  return np.convolve(padded, np.full(AVERAGED, 1.0 / AVERAGED), mode="valid")
