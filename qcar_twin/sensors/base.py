"""What a sensor of N simulated cars is: when it samples, and how it is put to work."""

import dataclasses
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.plant import SIGNALS
from qcar_twin.sensors.streams import CarStreams

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
MOTOR_SPEED = SIGNALS.index("motor_speed")
POSE = [SIGNALS.index(name) for name in ("pose_x", "pose_y", "pose_yaw")]
IMU = [SIGNALS.index(name) for name in ("accel_x", "accel_y", "yaw_rate")]


@dataclasses.dataclass(frozen=True)
class Timing:
  """When a sensor samples and when its samples arrive.

  Attributes:
    rate: Hz; the control rate must be a multiple of it.
    latency: from measurement to arrival, s, rounded to control periods.
    dropout: probability of losing a sample.
  """

  rate: float = 100.0
  latency: float = 0.0
  dropout: float = 0.0

  def every(self, period: float) -> int:
    """Control periods between samples."""
    periods = round(1.0 / (self.rate * period))
    if periods < 1 or abs(periods * period * self.rate - 1.0) > 1e-6:
      raise ValueError(f"a sensor rate of {self.rate:g} Hz does not divide the control rate of {1.0 / period:g} Hz")
    return periods


class SensorRun(Protocol):
  """A sensor under way in N runs."""

  def observe(self, signals: Array) -> None:
    """See the signals (N, 10) at the end of every control period, sampled or not."""
    ...

  def sample(self, signals: Array) -> Array:
    """Measure now: (N, c) for the sensor's c channels."""
    ...

  def restart(self, which: Mask, signals: Array) -> None:
    """Restart some of the runs at these signals."""
    ...


class Sensor(Protocol):
  """A sensor's settings; `begin` puts it to work."""

  @property
  def timing(self) -> Timing:
    """When it samples."""
    ...

  @property
  def channels(self) -> tuple[str, ...]:
    """Names of what it measures."""
    ...

  def begin(self, count: int, period: float, rng: np.random.Generator | CarStreams) -> SensorRun:
    """Put it to work in N cars, with control periods of `period` s and its own random stream."""
    ...
