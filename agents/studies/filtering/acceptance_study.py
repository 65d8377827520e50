"""What the online filter must get through on any car: the limit of grip, clocks that jump, silence, faulty sensors.

Cars are driven open loop, forward and in reverse, by commands that know nothing of them; sensors are those of
`qcar_sensors`. An estimate is honest where errors exceed their stated bounds in few of the periods that are called
valid, and where no sensor is accused that is sound.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from agents.studies.fault_study import BEGIN, FAULTS, SPEED, SWING, SWING_PERIOD
from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.estimate import Estimate
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.offline import angle_error, position_nees
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.plant import POSE, POSITION, START, YAW, Simulation
from qcar_twin.sensors.faults import Fault
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
LIMIT = np.array([(4.0, 0.3), (4.0, -0.3), (-4.0, 0.3), (-4.0, -0.3), (3.0, 0.3), (-3.0, -0.3)])  # V, rad
LIMIT_SECONDS, WEAVE_SECONDS = 8.0, 20.0
LOCK, LOCK_SPEED, LOCK_PERIOD = 0.5, 1.0, 1.0  # rad, m/s with straight wheels, s from one side to the other and back
EPOCH = 1000.0  # s, what the clock shows at the start
SENSORS = ("encoder", "gyro", "poses")  # words of the warnings


@dataclasses.dataclass(frozen=True)
class Subject:
  """A car that is driven, and what its filter knows of it.

  Attributes:
    begin: cars at starts (N, 7).  car: the filter's model.  settings: of the filter.
  """

  name: str
  begin: Callable[[Array], Simulation]
  car: SingleTrackCar
  settings: FilterSettings


@dataclasses.dataclass(frozen=True)
class Case:
  """What happens.

  Attributes:
    faults: of the sensors.  jump: s by which the clock is set back at BEGIN.  silence: s from then on without a sample.
    accused: words of sensors that may be accused, for they are wrong.
  """

  faults: tuple[Fault, ...] = ()
  jump: float = 0.0
  silence: float = 0.0
  accused: tuple[str, ...] = ()


_GUILTY = {
  "gyro bias jump": ("gyro",),
  "encoder stuck": ("encoder",),
  "latency doubled unsaid": ("poses",),
  "spikes": ("encoder", "gyro"),
}
CASES = {
  "sound": Case(),
  "clock back 5 s": Case(jump=5.0),
  "clock back 1000 s": Case(jump=1000.0),
  "silence of 2 s": Case(silence=2.0),
  "silence of 7 s": Case(silence=7.0),
} | {
  name + (f" {i + 1}" if len(kind.variants) > 1 else ""): Case(faults, accused=_GUILTY.get(name, ()))
  for name, kind in FAULTS.items()
  for i, faults in enumerate(kind.variants)
  if faults
}


@dataclasses.dataclass(frozen=True)
class Driven:
  """True signals (T + 1, N, 10) and commands (T, N, 2) of N cars."""

  signals: Array
  commands: Array


@dataclasses.dataclass(frozen=True)
class Outcome:
  """What the filter made of N cars; (T, N).

  Attributes:
    position: error, m.  yaw: error, rad.  bounds: of both, (T, N, 2).  nees: of the position.
    accused: words of sensors that were accused at some time, for each car.
  """

  position: Array
  yaw: Array
  bounds: Array
  nees: Array
  valid: Mask
  accused: tuple[frozenset[str], ...]

  @property
  def beyond(self) -> float:
    """Share of the valid periods in which position or yaw is beyond its bound."""
    wrong = (np.stack([self.position, np.abs(self.yaw)], axis=-1) > self.bounds).any(axis=-1)
    return float((wrong & self.valid).sum() / max(self.valid.sum(), 1))

  def of(self, which: Mask) -> "Outcome":
    """Some of the cars."""
    accused = tuple(words for words, some in zip(self.accused, which, strict=True) if some)
    position, yaw, bounds, nees = (a[:, which] for a in (self.position, self.yaw, self.bounds, self.nees))
    return Outcome(position, yaw, bounds, nees, self.valid[:, which], accused)

  def falsely(self, case: Case) -> int:
    """Cars of which a sensor is accused that is sound."""
    return sum(bool(words - set(case.accused)) for words in self.accused)


def limit_drive(subject: Subject) -> Driven:
  """Six cars at the limit of grip, forward and in reverse."""
  return drive(subject, at_the_limit, LIMIT_SECONDS)


def weave_drive(subject: Subject) -> Driven:
  """Two cars weaving, forward and in reverse."""
  return drive(subject, weaving(subject.car), WEAVE_SECONDS)


def lock_drive(subject: Subject) -> Driven:
  """Two cars whose wheels are thrown from stop to stop, forward and in reverse."""
  return drive(subject, from_stop_to_stop(subject.car), LIMIT_SECONDS)


def drive(subject: Subject, commands: Callable[[float], Array], seconds: float) -> Driven:
  """Drive by commands (N, 2) over time; cars start at rest, ten metres apart."""
  period = subject.settings.period
  first = commands(0.0)
  start = np.zeros((len(first), len(START)))
  start[:, 1] = 10.0 * np.arange(len(first))
  simulation = subject.begin(start)
  signals, given = [simulation.signals.copy()], []
  for k in range(round(seconds / period)):
    given.append(commands(k * period))
    signals.append(simulation.step(given[-1]).copy())
  return Driven(np.stack(signals), np.stack(given))


def at_the_limit(time: float) -> Array:
  """Full throttle for two seconds, then a step steer: understeer and spins, forward and in reverse; (6, 2)."""
  ramp = min(1.0, time), min(1.0, max(0.0, (time - 2.0) / 0.3))
  return LIMIT * ramp


def weaving(car: SingleTrackCar) -> Callable[[float], Array]:
  """Weaving at 0.3 to 0.7 m/s, one car forward and one in reverse; (2, 2)."""

  def commands(time: float) -> Array:
    speed = SPEED + SWING * math.sin(2.0 * math.pi * time / SWING_PERIOD)
    hold = _holding(car, speed)
    return np.array([(hold, 0.25 * math.sin(0.9 * time)), (-hold, 0.25 * math.sin(0.9 * time))], dtype=np.float64)

  return commands


def from_stop_to_stop(car: SingleTrackCar) -> Callable[[float], Array]:
  """Full lock, left and right in turn, one car forward and one in reverse; (2, 2)."""

  def commands(time: float) -> Array:
    hold = _holding(car, LOCK_SPEED * min(1.0, time))
    angle = LOCK * math.copysign(1.0, math.sin(2.0 * math.pi * time / LOCK_PERIOD)) if time > 1.5 else 0.0
    return np.array([(hold, angle), (-hold, angle)], dtype=np.float64)

  return commands


def _holding(car: SingleTrackCar, speed: float) -> float:
  """V that hold a speed, m/s, straight on."""
  return float((car.drive_damping * speed / car.rolling_radius + car.drive_friction) / car.drive_gain)


def judge(subject: Subject, driven: Driven, case: Case, seed: int = 1) -> Outcome:
  """The online filter on a drive, each car by itself."""
  period, count = subject.settings.period, driven.signals.shape[1]
  suite = SensorSuite(qcar_sensors(), count, seed, period, case.faults)
  online = [FederatedFilter(subject.car, subject.settings) for _ in range(count)]
  clock = lambda t: EPOCH + t - (case.jump if t >= BEGIN else 0.0)
  rows: list[list[Estimate]] = []
  for k, commands in enumerate(driven.commands):
    now = (k + 1) * period
    quiet = BEGIN <= now < BEGIN + case.silence
    for reading in suite.measure(driven.signals[k + 1]):
      for one, values in zip(online, reading.values.tolist(), strict=True):
        _tell(one, clock(now - reading.age * period), reading.channels, () if quiet else values)
    for one, values in zip(online, commands.tolist(), strict=True):
      _tell(one, clock(k * period), ("motor_voltage", "steering_command"), () if quiet else values)
    rows.append([one.estimate(clock(now)) for one in online])
  return _outcome(rows, driven.signals[1:])


def _tell(online: FederatedFilter, time: float, channels: tuple[str, ...], values: list[float] | tuple[()]) -> None:
  for channel, value in zip(channels, values, strict=False):
    if math.isfinite(value):
      online.update(time, channel, value)


def _outcome(rows: list[list[Estimate]], truth: Array) -> Outcome:
  pick = lambda f: np.array([[f(e) for e in row] for row in rows])
  pose, covariance = pick(lambda e: (e.pose_x, e.pose_y, e.pose_yaw)), pick(lambda e: e.covariance)
  valid = pick(lambda e: e.valid)
  off = np.where(valid[..., None], pose[..., POSITION] - truth[..., POSITION], np.nan)
  turned = angle_error(pose[..., YAW], truth[..., POSE][..., YAW])
  words = [
    frozenset(w for row in rows for text in row[i].warnings for w in SENSORS if text.startswith(f"the {w} "))
    for i in range(valid.shape[1])
  ]
  nees = np.where(valid, position_nees(off, np.where(valid[..., None], covariance, np.nan)), np.nan)
  return Outcome(np.hypot(off[..., 0], off[..., 1]), turned, pick(lambda e: e.bounds), nees, valid, tuple(words))
