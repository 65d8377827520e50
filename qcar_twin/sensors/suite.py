"""All sensors of N simulated cars: rates, latencies, dropouts, faults.

Every sensor has its own random stream, so that a seed reproduces a run bit for bit and switching one sensor off
leaves the others as they were. With a seed per car every car has its own, too: it senses the same whoever is beside it.
"""

import dataclasses
import zlib
from collections.abc import Sequence

import numpy as np

from qcar_twin.sensors.base import Array, Mask, Sensor, SensorRun
from qcar_twin.sensors.faults import Fault, FaultRun
from qcar_twin.sensors.onboard import Encoder, Imu
from qcar_twin.sensors.statistical_lidar import StatisticalLidar
from qcar_twin.sensors.streams import CarStreams


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
    seed: of the whole suite, or one per car.
    period: control period, s.
    faults: what makes them wrong.
  """

  def __init__(
    self,
    sensors: dict[str, Sensor],
    count: int,
    seed: int | Sequence[int],
    period: float = 0.01,
    faults: tuple[Fault, ...] = (),
  ):
    if not isinstance(seed, (int, np.integer)) and len(seed) != count:
      raise ValueError(f"{len(seed)} seeds for {count} cars: give one for all or one for each")
    self.count, self.period, self.faults = count, period, faults
    self.sensors = dict(sensors)
    self._rngs = {name: _stream(seed, zlib.crc32(name.encode())) for name in sensors}
    self._runs = {name: s.begin(count, period, self._rngs[name]) for name, s in sensors.items()}
    self._lost = {name: _stream(seed, zlib.crc32(name.encode()), 1) for name in sensors}
    self._every = {name: sensor.timing.every(period) for name, sensor in sensors.items()}
    self._latency = {name: round(sensor.timing.latency / period) for name, sensor in sensors.items()}
    # what is under way: period of arrival, of measurement as it will be reported, samples
    self._waiting: dict[str, list[tuple[int, int, Array]]] = {name: [] for name in sensors}
    self._faults = [FaultRun(fault, _stream(seed, 2, i)) for i, fault in enumerate(faults)]
    self._step = -1

  def restart(self, which: Mask, signals: Array) -> None:
    """Restart some runs, (N,): new biases, nothing under way."""
    for name, run in self._runs.items():
      run.restart(which, signals)
      for _, _, values in self._waiting[name]:
        values[which] = np.nan

  def measure(self, signals: Array) -> list[Reading]:
    """What arrives at the end of a control period with these signals, (N, 10); call it once per period."""
    self._step += 1
    arrived = []
    for name, sensor in self.sensors.items():
      run = self._runs[name]
      run.observe(signals)
      if self._step % self._every[name] == 0:
        self._waiting[name].append((*self._delays(name, sensor), self._sample(name, sensor, run, signals)))
      while self._waiting[name] and self._step >= self._waiting[name][0][0]:
        _, stamp, values = self._waiting[name].pop(0)
        arrived.append(Reading(sensor.channels, self._step - stamp, values))
    return arrived

  def _delays(self, name: str, sensor: Sensor) -> tuple[int, int]:
    """Periods in which a sample taken now arrives, and is said to have been taken."""
    delays = np.sum(
      [fault.delay(sensor.channels, self._step * self.period) for fault in self.faults] or [[0.0, 0.0]], 0
    )
    late, unsaid = (round(delay / self.period) for delay in delays)
    return self._step + self._latency[name] + late, self._step + unsaid

  def _sample(self, name: str, sensor: Sensor, run: SensorRun, signals: Array) -> Array:
    values = run.sample(signals)
    if sensor.timing.dropout:
      lost = self._lost[name].random(self.count) < sensor.timing.dropout
      values = np.where(lost[:, None], np.nan, values)
    for fault in self._faults:
      values = fault.apply(sensor.channels, self._step * self.period, values)
    return values


def _stream(seed: int | Sequence[int], *key: int) -> np.random.Generator | CarStreams:
  """What a sensor draws from."""
  return np.random.default_rng([seed, *key]) if isinstance(seed, (int, np.integer)) else CarStreams(seed, *key)


def qcar_sensors() -> dict[str, Sensor]:
  """IMU and encoder at 100 Hz, lidar pose at 10 Hz from its statistics."""
  return {"imu": Imu(), "encoder": Encoder(), "lidar": StatisticalLidar()}
