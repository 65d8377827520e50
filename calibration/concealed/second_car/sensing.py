"""The second car's sensors: a filtered IMU, an encoder with an eccentric disc, a camera above the room."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from scipy.signal import butter, lfilter, lfilter_zi

from ..laboratory.manoeuvres import PERIOD
from .simulation import FINE, SIGNALS

IMU_CUTOFF = 80.0  # Hz, of a Butterworth filter of second order
COUNTS = 4 * 720  # of the encoder per turn of the motor
WINDOW = 3  # rows of the trace (6 ms) over which counts are differenced
ECCENTRIC = 0.003  # of the speed, once a turn
POSE_EVERY = 5  # ticks
LOST = 0.01  # share of the camera's pictures without the car
DISTORTION = (0.003, 1.3)  # m rms, rad/m: what a camera's calibration leaves over, smooth over the room
NOISE = {"accel": 0.04, "gyro": 0.004, "encoder": 0.4, "pose": 0.002, "heading": 0.004}  # rms; m/s^2, rad/s, m, rad
SHAKEN = {"accel": 0.04, "gyro": 0.002}  # rms per m/s of speed
BIAS = {"accel": (0.025, 0.006), "gyro": (0.002, 0.0005)}  # rms of a session, of a run
DECIMALS = {
  "motor_voltage": 4, "steering_command": 5, "motor_speed": 2, "accel_x": 3, "accel_y": 3, "yaw_rate": 4,
  "pose_x": 4, "pose_y": 4, "pose_yaw": 4,
}  # fmt: skip


def sense(
  car: SimpleNamespace, trace: np.ndarray, noise: float, rng: np.random.Generator
) -> dict[str, np.ndarray]:  # fmt: skip
  """Channels (T, n) on the control grid; `noise` scales what is random, at 0 the rest is left."""
  ticks = (len(trace) - 1) // FINE
  signal = {name: trace[:, row] for row, name in enumerate(SIGNALS)}
  cos, sin = np.cos(car.imu_twist), np.sin(car.imu_twist)
  imu = {
    "accel_x": cos * signal["accel_x"] + sin * signal["accel_y"],
    "accel_y": cos * signal["accel_y"] - sin * signal["accel_x"],
    "yaw_rate": (1.0 + car.gyro_gain) * signal["yaw_rate"],
  }
  grid = slice(0, FINE * ticks, FINE)
  out = {name: _late(_filtered(values), car.imu_delay)[grid] for name, values in imu.items()}
  shape, speed = (ticks, trace.shape[2]), np.abs(signal["vx"][grid])
  for name in imu:
    kind = "gyro" if name == "yaw_rate" else "accel"
    session, run = (
      noise * size * rng.standard_normal(count) for size, count in zip(BIAS[kind], (1, shape[1]), strict=True)
    )
    shake = np.hypot(NOISE[kind], SHAKEN[kind] * speed)
    out[name] = out[name] + session + run + noise * shake * rng.standard_normal(shape)
  out["motor_speed"] = _encoder(signal, noise, rng)[grid]
  return out | _camera(car, signal, grid, noise, rng)


def _filtered(values: np.ndarray) -> np.ndarray:
  """Through the IMU's filter, which has settled before the start."""
  b, a = butter(2, IMU_CUTOFF, fs=FINE / PERIOD)  # pyright: ignore[reportAssignmentType, reportGeneralTypeIssues]
  settled = np.multiply.outer(lfilter_zi(b, a), values[0])
  return np.asarray(lfilter(b, a, values, axis=0, zi=settled)[0])


def _late(values: np.ndarray, delay: np.ndarray) -> np.ndarray:
  """Mean over the half of a delay around it (n,) [s], held before the start: what a slow bus and a mean leave."""
  if not np.any(delay):
    return values
  rows, steps = np.arange(len(values)), np.linspace(0.75, 1.25, 9)
  moved = [
    [np.interp(rows - s * d * FINE / PERIOD, rows, v) for v, d in zip(values.T, delay, strict=True)] for s in steps
  ]
  return np.mean(moved, axis=0).T


def _encoder(signal: dict[str, np.ndarray], noise: float, rng: np.random.Generator) -> np.ndarray:
  """Counts differenced over WINDOW rows; before the start the motor turned at its first speed."""
  angle, first = signal["motor_angle"], signal["motor"][0]
  row = PERIOD / FINE
  before = angle[0] - first * row * np.arange(WINDOW, 0, -1)[:, None]
  whole = np.concatenate([before, angle]) + rng.uniform(0, 2 * np.pi, angle.shape[1])
  counts = np.floor((whole + ECCENTRIC * np.sin(whole)) * COUNTS / (2 * np.pi))
  speed = (counts[WINDOW:] - counts[:-WINDOW]) * (2 * np.pi / COUNTS / (WINDOW * row))
  turning = np.minimum(np.abs(signal["motor"]) / 10.0, 1.0)
  return speed + noise * NOISE["encoder"] * turning * rng.standard_normal(speed.shape)


def _camera(
  car: SimpleNamespace, signal: dict[str, np.ndarray], grid: slice, noise: float, rng: np.random.Generator
) -> dict[str, np.ndarray]:
  """Pose of the tracked point, bent by what is left of the lens, with pictures in which it was not found."""
  x, y, yaw = (signal[name][grid] for name in ("x", "y", "yaw"))
  cos, sin = np.cos(yaw), np.sin(yaw)
  x, y = x + cos * car.marker_x - sin * car.marker_y, y + sin * car.marker_x + cos * car.marker_y
  size, number = DISTORTION
  phase = rng.uniform(0, 2 * np.pi, 4)
  bent_x = size * (np.sin(number * x + phase[0]) + np.sin(number * y + phase[1]))
  bent_y = size * (np.sin(number * x + phase[2]) + np.sin(number * y + phase[3]))
  seen = rng.random(x.shape) >= LOST * min(noise, 1.0)
  white = rng.standard_normal((3, *x.shape))
  columns = {
    "pose_x": x + noise * (bent_x + NOISE["pose"] * white[0]),
    "pose_y": y + noise * (bent_y + NOISE["pose"] * white[1]),
    "pose_yaw": yaw + noise * NOISE["heading"] * white[2],
  }
  return {name: np.where(seen, values, np.nan) for name, values in columns.items()}
