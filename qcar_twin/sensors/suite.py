"""IMU, encoder and lidar pose of N simulated cars: rates, latencies, dropouts, noise, faults.

Sensors read the ten signals of `qcar_twin.plant`. Every sensor has its own random stream, so that a seed
reproduces a run bit for bit and switching one sensor off leaves the others as they were.
"""

import dataclasses
import math
import zlib
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.plant import SIGNALS
from qcar_twin.sensors.faults import Fault
from qcar_twin.sensors.noise import ChannelNoise, ErrorStream
from qcar_twin.sensors.score import ScoreVariance

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


@dataclasses.dataclass(frozen=True)
class Imu:
  """Specific force at the IMU and yaw rate. Defaults: a MEMS unit on a car with running motor."""

  timing: Timing = Timing()
  accel: ChannelNoise = ChannelNoise(white=0.15, bias=0.05, walk=0.003)  # m/s^2
  gyro: ChannelNoise = ChannelNoise(white=0.01, bias=0.003, walk=0.0003)  # rad/s
  channels = ("accel_x", "accel_y", "yaw_rate")

  def begin(self, count: int, period: float, rng: np.random.Generator) -> "ImuRun":
    return ImuRun(ErrorStream((self.accel, self.accel, self.gyro), count, 1.0 / self.timing.rate, rng))


class ImuRun:
  def __init__(self, errors: ErrorStream):
    self._errors = errors

  def observe(self, signals: Array) -> None:
    """Nothing to remember between samples."""

  def sample(self, signals: Array) -> Array:
    """accel_x, accel_y, yaw_rate, (N, 3)."""
    return signals[:, IMU] + self._errors.sample()

  def restart(self, which: Mask, signals: Array) -> None:
    self._errors.restart(which)


@dataclasses.dataclass(frozen=True)
class Encoder:
  """Motor speed as the difference of whole counts. Default counts per motor turn: 720 lines, four edges (Quanser)."""

  timing: Timing = Timing()
  counts: int = 2880
  channels = ("motor_speed",)

  def begin(self, count: int, period: float, rng: np.random.Generator) -> "EncoderRun":
    return EncoderRun(self, count, period, rng)


class EncoderRun:
  def __init__(self, encoder: Encoder, count: int, period: float, rng: np.random.Generator):
    self._count, self._period = 2.0 * math.pi / encoder.counts, period  # rad, s
    self._interval = 1.0 / encoder.timing.rate
    self._angle = rng.uniform(0.0, self._count, count)  # rad, from a random place between two edges
    self._last = np.floor(self._angle / self._count)
    self._speed: Array | None = None

  def observe(self, signals: Array) -> None:
    """Turn the motor by the period just driven (trapezoidal rule)."""
    speed = signals[:, MOTOR_SPEED]
    before = speed if self._speed is None else self._speed
    self._angle = self._angle + 0.5 * (before + speed) * self._period
    self._speed = speed

  def sample(self, signals: Array) -> Array:
    """Mean motor speed since the last sample, rad/s, (N, 1)."""
    edges = np.floor(self._angle / self._count)
    speed = (edges - self._last) * self._count / self._interval
    self._last = edges
    return speed[:, None]

  def restart(self, which: Mask, signals: Array) -> None:
    if self._speed is not None:
      self._speed = np.where(which, signals[:, MOTOR_SPEED], self._speed)


@dataclasses.dataclass(frozen=True)
class StatisticalLidar:
  """Lidar pose and score without a scan: the true pose plus errors of the size the score tells.

  The score wanders (first order, log-normal); position and yaw errors have the variance of the score and
  are coloured, because a map's faults change only as the car moves on.

  Attributes:
    position, yaw: variance by score, m^2 and rad^2.
    correlation: time constant of the errors, s.
    coloured: share of the standard deviation that is coloured; the rest of the variance is white.
    score: median.  score_spread: standard deviation of its logarithm.  score_correlation: s.
    spike_chance, spike_size: per fix, m; a spike hits x and y, its score is a good one's.
  """

  timing: Timing = Timing(rate=10.0, latency=0.05, dropout=0.01)
  position: ScoreVariance = ScoreVariance.between(0.006, 0.05, 20.0)
  yaw: ScoreVariance = ScoreVariance.between(0.006, 0.05, 20.0)
  correlation: float = 0.3
  coloured: float = 0.9
  score: float = 80.0
  score_spread: float = 0.25
  score_correlation: float = 2.0
  spike_chance: float = 0.01
  spike_size: float = 0.5
  channels = ("pose_x", "pose_y", "pose_yaw", "pose_score")

  def begin(self, count: int, period: float, rng: np.random.Generator) -> "StatisticalLidarRun":
    return StatisticalLidarRun(self, count, rng)


class StatisticalLidarRun:
  def __init__(self, lidar: StatisticalLidar, count: int, rng: np.random.Generator):
    self._lidar = lidar
    interval = 1.0 / lidar.timing.rate
    white = math.sqrt(1.0 - lidar.coloured**2)
    error = ChannelNoise(white=white, coloured=lidar.coloured, correlation=lidar.correlation)
    score = ChannelNoise(coloured=lidar.score_spread, correlation=lidar.score_correlation)
    self._errors = ErrorStream((error, error, error, score), count, interval, rng)
    self._rng = rng

  def observe(self, signals: Array) -> None:
    """Nothing to remember between samples."""

  def sample(self, signals: Array) -> Array:
    """pose_x, pose_y, pose_yaw, pose_score, (N, 4)."""
    lidar, errors = self._lidar, self._errors.sample()
    score = lidar.score * np.exp(errors[:, 3])
    std = np.sqrt(np.stack([lidar.position.of(score), lidar.position.of(score), lidar.yaw.of(score)], axis=-1))
    pose = signals[:, POSE] + std * errors[:, :3]
    lots = self._rng.random((2, len(score)))
    angle, hit = 2.0 * np.pi * lots[1], lots[0] < lidar.spike_chance
    pose[:, 0] += np.where(hit, lidar.spike_size * np.cos(angle), 0.0)
    pose[:, 1] += np.where(hit, lidar.spike_size * np.sin(angle), 0.0)
    return np.concatenate([pose, score[:, None]], axis=1)

  def restart(self, which: Mask, signals: Array) -> None:
    self._errors.restart(which)


class SensorRun(Protocol):
  """A sensor under way in N runs."""

  def observe(self, signals: Array) -> None: ...

  def sample(self, signals: Array) -> Array: ...

  def restart(self, which: Mask, signals: Array) -> None: ...


class Sensor(Protocol):
  """A sensor's settings; `begin` puts it to work."""

  @property
  def timing(self) -> Timing: ...

  @property
  def channels(self) -> tuple[str, ...]: ...

  def begin(self, count: int, period: float, rng: np.random.Generator) -> SensorRun: ...


@dataclasses.dataclass(frozen=True)
class Reading:
  """Samples of one sensor as they arrive.

  Attributes:
    channels: c names.
    age: control periods since they were measured.
    values: (N, c); NaN where a run lost the sample.
  """

  channels: tuple[str, ...]
  age: int
  values: Array


class SensorSuite:
  """All sensors of N runs.

  Args:
    sensors: by name; the name seeds the sensor's random stream.
    count: N.
    seed: of the whole suite.
    period: control period, s.
    faults: added to what the sensors say.
  """

  def __init__(
    self, sensors: dict[str, Sensor], count: int, seed: int, period: float = 0.01, faults: tuple[Fault, ...] = ()
  ):
    self.count, self.period, self.faults = count, period, faults
    self.sensors = dict(sensors)
    self._rngs = {name: np.random.default_rng([seed, zlib.crc32(name.encode())]) for name in sensors}
    self._runs = {name: s.begin(count, period, self._rngs[name]) for name, s in sensors.items()}
    self._lost = {name: np.random.default_rng([seed, zlib.crc32(name.encode()), 1]) for name in sensors}
    self._every = {name: sensor.timing.every(period) for name, sensor in sensors.items()}
    self._latency = {name: round(sensor.timing.latency / period) for name, sensor in sensors.items()}
    self._waiting: dict[str, list[tuple[int, Array]]] = {name: [] for name in sensors}
    self._step = -1

  def restart(self, which: Mask, signals: Array) -> None:
    """Begin some runs anew (N,): new biases, nothing under way."""
    for name, run in self._runs.items():
      run.restart(which, signals)
      for _, values in self._waiting[name]:
        values[which] = np.nan

  def measure(self, signals: Array) -> list[Reading]:
    """What arrives at the end of a control period with these signals, (N, 10); call it once per period."""
    self._step += 1
    arrived = []
    for name, sensor in self.sensors.items():
      run = self._runs[name]
      run.observe(signals)
      if self._step % self._every[name] == 0:
        self._waiting[name].append((self._step, self._sample(name, sensor, run, signals)))
      while self._waiting[name] and self._step - self._waiting[name][0][0] >= self._latency[name]:
        stamp, values = self._waiting[name].pop(0)
        arrived.append(Reading(sensor.channels, self._step - stamp, values))
    return arrived

  def _sample(self, name: str, sensor: Sensor, run: SensorRun, signals: Array) -> Array:
    values = run.sample(signals)
    lost = self._lost[name].random(self.count) < sensor.timing.dropout
    values = np.where(lost[:, None], np.nan, values)
    for fault in self.faults:
      values = fault.apply(sensor.channels, self._step * self.period, values)
    return values


def qcar_sensors() -> dict[str, Sensor]:
  """IMU and encoder at 100 Hz, lidar pose at 10 Hz from its statistics."""
  return {"imu": Imu(), "encoder": Encoder(), "lidar": StatisticalLidar()}
