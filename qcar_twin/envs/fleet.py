"""N cars on the path-tracking task: plant, sensors and filter, speed control, progress, reward, ends, restarts.

Every car has random streams of its own, from its own seed: what happens to a car does not depend on which other
cars drive beside it. The environments only translate; everything they do is done here.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_twin.envs.bodies import bodies_of
from qcar_twin.envs.task import TrackingTask
from qcar_twin.estimation.batch import BatchEstimate
from qcar_twin.estimation.observer import Observer, SensedObserver, TrueObserver
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.past import remember
from qcar_twin.paths import Errors
from qcar_twin.plant import Plant
from qcar_twin.sensors.base import Sensor
from qcar_twin.sensors.suite import Reading, SensorSuite
from qcar_twin.single_track import Car

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class SpeedControl(Protocol):
  """A speed controller of N cars."""

  def restart(self, which: Mask, speed: Array) -> None:
    """Take over some cars anew at speeds (N,), m/s."""
    ...

  def voltage(self, speed: Array, target: ArrayLike, period: float) -> Array:
    """Motor voltage, V, (N,)."""
    ...


Demonstrator = Callable[[Errors, Array], Array]
"""Steering angle, rad, (N,), an expert would set for errors and speeds (N,)."""


@dataclasses.dataclass(frozen=True)
class Spread:
  """Parameters drawn anew for every episode around the nominal ones.

  Attributes:
    names: of the plant's parameters.
    covariance: (k, k), units of the parameters; draws are cut at the parameters' bounds.
  """

  names: tuple[str, ...]
  covariance: Array

  def draw(self, plant: Plant, theta: Array, rng: np.random.Generator) -> Array:
    """One parameter vector, (P,), around theta, (P,)."""
    columns = [plant.parameters.index(name) for name in self.names]
    values, vectors = np.linalg.eigh(self.covariance)
    step = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(columns)))
    out = np.array(theta)
    out[columns] = np.clip(out[columns] + step, plant.parameters.lower[columns], plant.parameters.upper[columns])
    return out


@dataclasses.dataclass(frozen=True)
class Outfit:
  """What the cars of a fleet consist of.

  Attributes:
    plant: makes the simulator; called for every batch that is needed.
    theta: its parameters, (P,).
    speed_control: from initial speeds (N,), m/s.
    demonstrator: None for none; then the task's m6 is without effect.
    sensors: by name; None for an agent that sees the truth.
    car, settings: of the filter behind the sensors.
    spread: of the plant's parameters over episodes; None for always the same.
  """

  plant: Callable[[], Plant]
  theta: Array
  speed_control: Callable[[Array], SpeedControl]
  demonstrator: Demonstrator | None = None
  sensors: dict[str, Sensor] | None = None
  car: Car | None = None
  settings: FilterSettings | None = None
  spread: Spread | None = None

  def observer(self, seeds: Sequence[int]) -> Observer:
    """What cars with these seeds know of themselves."""
    if self.sensors is None:
      return TrueObserver()
    if self.car is None:
      raise ValueError("sensors need the identified model of the filter behind them: give `car`")
    return SensedObserver(CarwiseSensors(self.sensors, seeds), self.car, self.settings)  # type: ignore[arg-type]


class CarwiseSensors:
  """Sensors of N cars with random streams that do not depend on one another.

  Args:
    sensors: by name.
    seeds: one per car.
  """

  def __init__(self, sensors: dict[str, Sensor], seeds: Sequence[int]):
    self.count = len(seeds)
    self._suites = [SensorSuite(sensors, 1, seed) for seed in seeds]

  def restart(self, which: Mask, signals: Array) -> None:
    for i in np.flatnonzero(which):
      self._suites[i].restart(np.ones(1, dtype=bool), signals[i : i + 1])

  def measure(self, signals: Array) -> list[Reading]:
    cars = [suite.measure(signals[i : i + 1]) for i, suite in enumerate(self._suites)]
    return [
      Reading(parts[0].channels, parts[0].age, np.concatenate([part.values for part in parts]))
      for parts in zip(*cars, strict=True)
    ]


class Linkage:
  """What happens to the steering commands of N cars on their way: delay, lag, gain, offset."""

  def __init__(self, task: TrackingTask, count: int):
    self._task = task
    self._share = 1.0 - math.exp(-task.period / task.servo_lag) if task.servo_lag > 0.0 else 1.0
    self._line = np.zeros((round(task.servo_delay / task.period), count))
    self._angle = np.zeros(count)
    self._gain, self._offset = np.ones(count), np.zeros(count)

  def restart(self, which: Mask, rngs: Sequence[np.random.Generator]) -> None:
    """Wheels straight, nothing under way, gain and offset of a new episode, in some cars; `rngs` has one per car."""
    self._line[:, which] = 0.0
    self._angle[which] = 0.0
    for i in np.flatnonzero(which):
      self._gain[i], self._offset[i] = self._task.linkage(rngs[int(i)])

  def pass_on(self, steering: Array) -> Array:
    """The command the plant gets, rad, (N,)."""
    line = np.concatenate([self._line, steering[None]])
    self._line = line[1:]
    self._angle = self._angle + self._share * (line[0] - self._angle)
    return self._gain * self._angle + self._offset


@dataclasses.dataclass(frozen=True)
class Outcome:
  """What a control period brought, (N,) each: reward; lost (`terminated`); at the end or out of time (`truncated`)."""

  reward: Array
  terminated: Mask
  truncated: Mask


class Fleet:
  """N cars under way.

  Args:
    task: what is driven.
    outfit: the cars.
    seeds: one per car.

  Attributes:
    signals: true, (N, 10).  steering: commanded, rad, (N,).  estimate: of the cars.
    errors: relative to the path, (2, N) each: as estimated, and true.  arc_length: likewise, m, (2, N).
    past: slow means of steering command and path curvature, rad and 1/m, (N, 2).
    episode_steps: control periods since the last restart, (N,).
  """

  def __init__(self, task: TrackingTask, outfit: Outfit, seeds: Sequence[int]):
    self.task, self.outfit, self.count = task, outfit, len(seeds)
    self._limits = outfit.plant() if outfit.spread else None
    self.seed(seeds)

  def seed(self, seeds: Sequence[int]) -> None:
    """Begin all cars anew as a fresh fleet with these seeds would."""
    if len(seeds) != self.count:
      raise ValueError(f"{len(seeds)} seeds for {self.count} cars")
    self._rngs = [np.random.default_rng([seed, 1]) for seed in seeds]
    everyone = np.ones(self.count, dtype=bool)
    theta, start = self._draw(everyone)
    self._bodies = bodies_of(self.outfit.plant, theta, start)
    self._observer = self.outfit.observer(seeds)
    self._linkage = Linkage(self.task, self.count)
    self._linkage.restart(everyone, self._rngs)
    self.steering = np.zeros(self.count)
    self.past = np.zeros((self.count, 2))
    self.episode_steps = np.zeros(self.count, dtype=np.int64)
    self.arc_length = np.zeros((2, self.count))
    self.estimate: BatchEstimate = self._observer.begin(self.signals)
    self._speed_control = self.outfit.speed_control(self.estimate.speed)
    self._look()

  @property
  def signals(self) -> Array:
    return self._bodies.signals

  @property
  def observation(self) -> Array:
    """What the agent sees, (N, 4): m, m/s, rad, rad/s."""
    return self.errors.observation[0]

  @property
  def cross_track(self) -> Array:
    """True cross-track error, m, (N,)."""
    return self.errors.cross_track[1]

  def restart(self, which: Mask) -> None:
    """New episodes for some cars, (N,)."""
    if not which.any():
      return
    theta, start = self._draw(which)
    self._bodies.restart(which, theta, start)
    self._linkage.restart(which, self._rngs)
    self.steering = np.where(which, 0.0, self.steering)
    self.past = np.where(which[:, None], 0.0, self.past)
    self.episode_steps = np.where(which, 0, self.episode_steps)
    self.arc_length = np.where(which, 0.0, self.arc_length)
    self.estimate = self._observer.begin(self.signals, which)
    self._speed_control.restart(which, self.estimate.speed)
    self._look()

  def expert(self) -> Array:
    """Steering angle the demonstrator would set now, rad, (N,); the present one where there is no demonstrator."""
    if self.outfit.demonstrator is None:
      return self.steering
    wanted = self.outfit.demonstrator(_pick(self.errors, self._judge), self._speeds()[self._judge])
    return np.clip(wanted, -self.task.lock, self.task.lock)

  def expert_action(self) -> Array:
    """Steering rate that brings the command to the demonstrator's angle, as far as the bound lets it, rad/s, (N,)."""
    wanted = (self.expert() - self.steering) / self.task.period
    return np.clip(wanted, -self.task.largest_rate, self.task.largest_rate)

  def step(self, action: Array) -> Outcome:
    """Drive one control period with steering rates (N,), rad/s. Cars whose episode ends must be restarted."""
    task = self.task
    rate = np.clip(np.asarray(action, dtype=np.float64).reshape(self.count), -task.largest_rate, task.largest_rate)
    expert = self.expert()
    self.steering = np.clip(self.steering + task.period * rate, -task.lock, task.lock)
    voltage = self._speed_control.voltage(np.nan_to_num(self.estimate.speed), task.speed, task.period)
    commands = np.stack([voltage, self.steering], axis=-1)
    self._observer.command(commands)
    applied = commands.copy()
    applied[:, 1] = self._linkage.pass_on(self.steering)
    self.estimate = self._observer.observe(self._bodies.step(applied))
    self.episode_steps = self.episode_steps + 1
    self._look(moving=True)
    self.past = remember(self.past, self.steering, self.errors.curvature[0], task.period)
    difference = self.steering - expert if self.outfit.demonstrator else np.zeros(self.count)
    judged = _pick(self.errors, self._judge)
    reward, lost = task.reward_of(judged.cross_track, judged.heading, rate, difference)
    lost |= ~np.isfinite(self.signals).all(axis=-1)
    over = (self.arc_length[1] >= task.distance) | (self.episode_steps >= task.longest)
    return Outcome(reward, lost, over & ~lost)

  @property
  def _judge(self) -> int:
    return 1 if self.task.judged_by_truth else 0

  def _draw(self, which: Mask) -> tuple[Array, Array]:
    """Parameters (N, P) and starts (N, 7) of cars that begin; rows of the others keep their parameters."""
    if which.all():
      self._theta = np.tile(self.outfit.theta, (self.count, 1))
    start = np.zeros((self.count, 7))
    for i in np.flatnonzero(which):
      start[i] = self.task.start_state(self._rngs[i])
      if self.outfit.spread and self._limits:
        self._theta[i] = self.outfit.spread.draw(self._limits, self.outfit.theta, self._rngs[i])
    return self._theta.copy(), start

  def _speeds(self) -> Array:
    """As estimated and true, m/s, (2, N)."""
    return np.stack([np.nan_to_num(self.estimate.speed), np.hypot(self.signals[:, 3], self.signals[:, 4])])

  def _look(self, moving: bool = False) -> None:
    """Errors at the nearest path point, searched around where the paper's ds/dt puts it."""
    path, signals, estimate = self.task.path, self.signals, self.estimate
    pose = np.nan_to_num(np.stack([estimate.pose, signals[:, :3]]))
    velocity = np.nan_to_num(np.stack([estimate.velocity, signals[:, 3:5]]))
    rate = np.nan_to_num(np.stack([estimate.yaw_rate, signals[:, 5]]))
    near = self.arc_length
    if moving:
      near = near + self.task.period * path.errors(near, pose, velocity, rate).arc_rate
    self.arc_length = path.nearest(pose[..., 0], pose[..., 1], near=near)
    self.errors = path.errors(self.arc_length, pose, velocity, rate)


def _pick(errors: Errors, which: int) -> Errors:
  """Estimated (0) or true (1) errors, (N,) each."""
  return Errors(*(getattr(errors, field.name)[which] for field in dataclasses.fields(Errors)))
