"""IMU, encoder and sensors of your own of N simulated cars; how noisy each is comes from its channel's record."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from qcar_twin.plant import signal_index
from qcar_twin.recordings.channels import CHANNELS, Channel
from qcar_twin.sensors.base import IMU, MOTOR_SPEED, Array, Mask, Timing
from qcar_twin.sensors.noise import ChannelNoise, ErrorStream
from qcar_twin.sensors.streams import CarStreams
from qcar_twin.vehicle.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class Imu:
  """Specific force at the IMU and yaw rate. Defaults: a MEMS unit on a car with running motor."""

  timing: Timing = Timing()
  accel: ChannelNoise = ChannelNoise(white=CHANNELS["accel_x"].noise, bias=0.05, walk=0.003)  # m/s^2
  gyro: ChannelNoise = ChannelNoise(white=CHANNELS["yaw_rate"].noise, bias=0.003, walk=0.0003)  # rad/s
  channels = ("accel_x", "accel_y", "yaw_rate")

  def begin(self, count: int, period: float, rng: np.random.Generator | CarStreams) -> "ImuRun":
    """Put it to work in N cars."""
    return ImuRun(ErrorStream((self.accel, self.accel, self.gyro), count, 1.0 / self.timing.rate, rng))


class ImuRun:
  """The IMU of N cars under way."""

  def __init__(self, errors: ErrorStream):
    self._errors = errors

  def observe(self, signals: Array) -> None:
    """Nothing to remember between samples."""

  def sample(self, signals: Array) -> Array:
    """accel_x, accel_y, yaw_rate, (N, 3)."""
    return signals[:, IMU] + self._errors.sample()

  def restart(self, which: Mask, signals: Array) -> None:
    """New biases for some cars."""
    self._errors.restart(which)


@dataclasses.dataclass(frozen=True)
class Encoder:
  """Motor speed as the difference of whole counts. Default counts per motor turn: 720 lines, four edges (Quanser)."""

  timing: Timing = Timing()
  counts: int = 2880
  channels = ("motor_speed",)

  def begin(self, count: int, period: float, rng: np.random.Generator | CarStreams) -> "EncoderRun":
    """Put it to work in N cars."""
    return EncoderRun(self, count, period, rng)


class EncoderRun:
  """The encoder of N cars under way: it turns with the motor and counts."""

  def __init__(self, encoder: Encoder, count: int, period: float, rng: np.random.Generator | CarStreams):
    self._count, self._period = 2.0 * math.pi / encoder.counts, period  # rad, s
    self._interval = 1.0 / encoder.timing.rate
    self._angle = rng.uniform(0.0, self._count, count)  # rad, from a random place between two edges
    self._last = np.floor(self._angle / self._count)
    self._speed: Array | None = None
    self._elapsed = self._interval - period  # s, since the last sample; the first one comes after a period

  def observe(self, signals: Array) -> None:
    """Turn the motor by the period just driven (trapezoidal rule)."""
    speed = signals[:, MOTOR_SPEED].copy()  # a simulation may write its signals in place
    before = speed if self._speed is None else self._speed
    if self._speed is None:
      self._last = self._edges_before(speed)
    self._angle = self._angle + 0.5 * (before + speed) * self._period
    self._speed = speed
    self._elapsed += self._period

  def sample(self, signals: Array) -> Array:
    """Mean motor speed since the last sample, rad/s, (N, 1)."""
    edges = np.floor(self._angle / self._count)
    speed = (edges - self._last) * self._count / self._interval
    self._last, self._elapsed = edges, 0.0
    return speed[:, None]

  def restart(self, which: Mask, signals: Array) -> None:
    """Some cars go on at another speed, as if they had driven at it since the last sample."""
    if self._speed is not None:
      speed = signals[:, MOTOR_SPEED]
      self._speed = np.where(which, speed, self._speed)
      self._last = np.where(which, self._edges_before(speed), self._last)

  def _edges_before(self, speed: Array) -> Array:
    """Edges counted until the last sample, if the motor has turned at a speed, rad/s, since."""
    return np.floor((self._angle - speed * self._elapsed) / self._count)


@dataclasses.dataclass(frozen=True)
class ModelledSensor:
  """A sensor of one channel that reads a function of the signals, with the white noise of the channel's record.

  Attributes:
    channel: its record.
    model: its reading from the signals (N,) by name and the car's numbers: the one its residual is predicted with.
    car: numbers of the cars.
    timing: when it samples.
  """

  channel: Channel
  model: Callable[[Callable[[str], Array], Vehicle], Array]
  car: Vehicle
  timing: Timing = Timing()

  @property
  def channels(self) -> tuple[str, ...]:
    """The one it measures."""
    return (self.channel.name,)

  def begin(self, count: int, period: float, rng: np.random.Generator | CarStreams) -> "ModelledRun":
    """Put it to work in N cars."""
    noise = ChannelNoise(white=0.0 if math.isnan(self.channel.noise) else self.channel.noise)
    return ModelledRun(self, ErrorStream((noise,), count, 1.0 / self.timing.rate, rng))


class ModelledRun:
  """Such a sensor of N cars under way."""

  def __init__(self, sensor: ModelledSensor, errors: ErrorStream):
    self._sensor, self._errors = sensor, errors

  def observe(self, signals: Array) -> None:
    """Nothing to remember between samples."""

  def sample(self, signals: Array) -> Array:
    """Its reading, (N, 1)."""
    value = self._sensor.model(lambda name: signals[:, signal_index(name)], self._sensor.car)
    return value[:, None] + self._errors.sample()

  def restart(self, which: Mask, signals: Array) -> None:
    """Its errors have no memory of a run."""
    self._errors.restart(which)
