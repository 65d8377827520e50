"""Drives by formula that never repeat themselves, of cars from 1:43 to full size."""

import numpy as np
from numpy.typing import NDArray

from tests.qcar_twin.recordings.drives import NOISE

Array = NDArray[np.float64]
Columns = dict[str, Array]
RATE, SECONDS = 50.0, 90.0
SIZES = {"1:43": 0.23, "1:10": 1.0, "1:5": 2.15, "full size": 11.0}  # of the 1:10 car's length


def wander(seed: int, size: float = 1.0, seconds: float = SECONDS) -> tuple[Array, Columns]:
  """Time (k,) and columns of a drive that never repeats itself, of a car `size` times as long as a 1:10 one.

  Speeds grow with sqrt(size), so that lateral accelerations are alike (Froude's similarity).
  """
  random, time = np.random.default_rng(seed), np.arange(int(seconds * RATE)) / RATE
  length, swift = 0.256 * size, np.sqrt(size)
  speed = swift * np.maximum(1.2 + 0.5 * _smooth(random, time.size, 1.5 * swift), 0.0)
  stop = 3.0 * max(float(swift), 1.0)
  standing = (time < stop) | ((time > 45.0) & (time < 45.0 + stop))
  speed = _rounded(np.where(standing, 0.0, speed), 0.4 * swift)
  steering = 0.3 * np.tanh(_smooth(random, time.size, 0.8 * swift))
  yaw_rate = speed * np.tan(steering) / length
  yaw = np.cumsum(yaw_rate) / RATE
  columns = {
    "motor_voltage": 4.0 * speed / swift,
    "steering_command": steering,
    "speed": speed,
    "accel_x": np.gradient(speed, time),
    "accel_y": speed * yaw_rate,
    "yaw_rate": yaw_rate,
    "pose_x": np.cumsum(speed * np.cos(yaw)) / RATE,
    "pose_y": np.cumsum(speed * np.sin(yaw)) / RATE,
    "pose_yaw": yaw,
  }
  for channel, sigma in (NOISE | {"speed": 0.005}).items():
    if channel in columns:
      columns[channel] = columns[channel] + sigma * random.standard_normal(time.size)
  return time, columns


def _smooth(random: np.random.Generator, count: int, seconds: float) -> Array:
  return _unit(_rounded(random.standard_normal(count), seconds))


def _rounded(values: Array, seconds: float) -> Array:
  width = seconds * RATE / 2.0
  kernel = np.exp(-0.5 * (np.arange(-int(4 * width), int(4 * width) + 1) / width) ** 2)
  return np.convolve(values, kernel / kernel.sum(), "same")


def _unit(values: Array) -> Array:
  return (values - values.mean()) / values.std()
