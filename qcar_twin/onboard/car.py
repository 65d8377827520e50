"""The car under a script: moved on by the clock, read through its sensors, everything logged.

The car moves in control periods of 10 ms. What it is told within one acts as the mean over it, so that a command
written between two samples is neither early nor lost; what is read is what the sensors said at the last sample.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from qcar_twin.onboard.plants import OnboardPlant
from qcar_twin.plant import Simulation
from qcar_twin.sensors.base import Sensor
from qcar_twin.sensors.suite import Reading, SensorSuite, qcar_sensors

Array = NDArray[np.float64]
COUNTS = 720 * 4  # encoder counts per turn of the motor: lines and edges
_EARLY = 1e-9  # s, below which two times are one
_INERTIAL = ("accel_x", "accel_y", "yaw_rate")


@dataclasses.dataclass(frozen=True)
class Sample:
  """What the car's own sensors said at a sample.

  Attributes:
    time: s.
    motor_speed: rad/s, from the encoder.  counts: of the encoder since the start.
    accel_x, accel_y: m/s^2.  yaw_rate: rad/s.
    voltage: on the motor in the period before, V.
  """

  time: float
  motor_speed: float
  counts: int
  accel_x: float
  accel_y: float
  yaw_rate: float
  voltage: float


@dataclasses.dataclass(frozen=True)
class Fix:
  """A pose that arrived: when, when it was measured [s], and x, y [m], yaw [rad] and score."""

  arrived: float
  measured: float
  x: float
  y: float
  yaw: float
  score: float


class Car:
  """One car of a plant with the QCar's sensors.

  Args:
    plant: what is driven.
    seed: of the sensors' noise.
    sensors: by name; the QCar's where not given.
  """

  def __init__(self, plant: OnboardPlant, seed: int = 0, sensors: dict[str, Sensor] | None = None):
    self.plant, self.vehicle, self.period, self.seed = plant, plant.vehicle, plant.period, seed
    self._suite = SensorSuite(sensors or qcar_sensors(), 1, seed, self.period)
    self._start = np.zeros((1, 7))
    self._simulation: Simulation | None = None
    self._command = np.zeros(2)  # in force: drive, in the vehicle's unit, and steering, rad
    self._since, self._integral = 0.0, np.zeros(2)
    self.commands: list[tuple[float, float]] = []  # of every period driven
    self.samples: list[Sample] = []
    self.fixes: list[Fix] = []
    self._held = dict.fromkeys((*_INERTIAL, "motor_speed"), 0.0)
    self._counts = 0

  @property
  def begun(self) -> bool:
    """Whether it has been looked at or moved, so that its start stands."""
    return self._simulation is not None

  @property
  def pose(self) -> tuple[float, float, float]:
    """Where it is: x, y [m], yaw [rad]."""
    x, y, yaw = self._under_way().signals[0, :3]
    return float(x), float(y), float(yaw)

  @property
  def signals(self) -> Array:
    """Its signals, (10,), in the order of `plant.SIGNALS`."""
    return self._under_way().signals[0].copy()

  def place(self, x: float, y: float, yaw: float) -> None:
    """Put it to a start before it is looked at or moved, m and rad."""
    if self.begun:
      raise RuntimeError("the car is under way and cannot be put elsewhere")
    self._start[0, :3] = x, y, yaw

  def tell(self, time: float, drive: float, steering: float) -> None:
    """Command the drive, in the vehicle's unit, and the steering, rad, from a time on, s."""
    self._integral += self._command * (time - self._since)
    self._since, self._command = time, np.array([drive, steering])

  def move(self, time: float) -> None:
    """Drive every control period that has ended by a time, s."""
    while (len(self.commands) + 1) * self.period <= time + _EARLY:
      self._drive_period()

  def sample(self, time: float) -> Sample:
    """The sample that stood at a time, s, that has come."""
    self._under_way()
    return self.samples[min(int((time + _EARLY) / self.period), len(self.samples) - 1)]

  def _under_way(self) -> Simulation:
    if self._simulation is None:
      self._simulation = self.plant.begin(self._start)
      self._look()
    return self._simulation

  def _drive_period(self) -> None:
    simulation, end = self._under_way(), (len(self.commands) + 1) * self.period
    mean = self._command
    if self._integral.any() or self._since > end - self.period + _EARLY:
      mean = (self._integral + self._command * (end - self._since)) / self.period
    self._integral[:], self._since = 0.0, end
    self.commands.append((float(mean[0]), float(mean[1])))
    signals = simulation.step(mean[None])
    if not np.isfinite(signals).all():
      raise ArithmeticError(f"the simulated car came apart after {end:.2f} s; drive it less hard")
    self._look()

  def _look(self) -> None:
    """Read the sensors at the end of a period."""
    assert self._simulation is not None
    time = len(self.commands) * self.period
    for reading in self._suite.measure(self._simulation.signals):
      values = dict(zip(reading.channels, reading.values[0].tolist(), strict=True))
      if "pose_x" in values:
        self._take_fix(time, reading, values)
      else:
        self._held |= {name: value for name, value in values.items() if math.isfinite(value)}
    self._counts += round(self._held["motor_speed"] * self.period * COUNTS / math.tau)
    drive = self.commands[-1][0] if self.commands else 0.0
    said = {name: self._held[name] for name in _INERTIAL}
    sample = Sample(time, self._held["motor_speed"], self._counts, voltage=drive * self.vehicle.command_scale, **said)
    self.samples.append(sample)

  def _take_fix(self, time: float, reading: Reading, values: dict[str, float]) -> None:
    if math.isfinite(values["pose_x"]):
      place = (values["pose_x"], values["pose_y"], values["pose_yaw"], values["pose_score"])
      self.fixes.append(Fix(time, time - reading.age * self.period, *place))
