"""N cars on the path-tracking task: `DrivenCars` with starts, reward, ends, restarts.

Every car has random streams of its own, from its own seed: what happens to a car does not depend on which other
cars drive with it. The environments only translate; everything they do is done here.
"""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.envs.car_batch import car_batch
from qcar_twin.envs.driven_cars import ESTIMATED, TRUE, Course, DrivenCars, Linkage, SpeedControl, one_of
from qcar_twin.envs.task import TrackingTask
from qcar_twin.estimation.observer import Observer, SensedObserver, TrueObserver
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.paths import Errors
from qcar_twin.plant import START, Plant
from qcar_twin.recent import Recent
from qcar_twin.sensors.base import Sensor
from qcar_twin.sensors.suite import SensorSuite
from qcar_twin.twin.posterior import normal_step

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


Demonstrator = Callable[[Errors, Array], Array]
"""Steering angle, rad, (N,), an expert would set for errors and speeds (N,)."""


class Drawn(Protocol):
  """How parameters differ from episode to episode: a `Spread`, or a `Posterior`."""

  def draw(self, plant: Plant, theta: Array, rng: np.random.Generator) -> Array:
    """One parameter vector, (P,), of a car whose nominal one is theta, (P,)."""
    ...


@dataclasses.dataclass(frozen=True)
class Spread:
  """Parameters drawn again for every episode around the nominal ones.

  Attributes:
    names: of the plant's parameters.
    covariance: (k, k), units of the parameters; draws are cut at the parameters' bounds.
  """

  names: tuple[str, ...]
  covariance: Array

  def draw(self, plant: Plant, theta: Array, rng: np.random.Generator) -> Array:
    """One parameter vector, (P,), around theta, (P,)."""
    columns = [plant.parameters.index(name) for name in self.names]
    out = np.array(theta)
    moved = out[columns] + normal_step(self.covariance, rng)
    out[columns] = np.clip(moved, plant.parameters.lower[columns], plant.parameters.upper[columns])
    return out


@dataclasses.dataclass(frozen=True)
class FleetConfig:
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
  car: SingleTrackCar | None = None
  settings: FilterSettings | None = None
  spread: Drawn | None = None

  def observer(self, seeds: Sequence[int], period: float = 0.01) -> Observer:
    """What cars with these seeds and control periods of so many s know of themselves."""
    if self.sensors is None:
      return TrueObserver()
    if self.car is None:
      raise ValueError("sensors need the identified model of the filter behind them: give `car`")
    settings = dataclasses.replace(self.settings or FilterSettings(), period=period)
    return SensedObserver(SensorSuite(self.sensors, len(seeds), seeds, period), self.car, settings)


@dataclasses.dataclass(frozen=True)
class Outcome:
  """What a control period brought, (N,) each: reward; lost (`terminated`); at the end or out of time (`truncated`);
  and the terms that the reward is the sum of, by name."""

  reward: Array
  terminated: Mask
  truncated: Mask
  terms: Mapping[str, Array] = dataclasses.field(default_factory=dict)


class Fleet:
  """N cars under way.

  Args:
    task: what is driven.
    config: the cars.
    seeds: one per car.

  Attributes:
    cars: the loop they drive in.  linkage: what their steering commands go through.
    episode_steps: control periods since the last restart, (N,).
  """

  def __init__(self, task: TrackingTask, config: FleetConfig, seeds: Sequence[int]):
    self.config, self.count = config, len(seeds)
    plant = config.plant()
    self._limits = plant if config.spread else None
    self.task = dataclasses.replace(task, period=plant.period)  # the plant owns the clock
    self.seed(seeds)

  def seed(self, seeds: Sequence[int]) -> None:
    """Restart all cars as a fresh fleet with these seeds would."""
    if len(seeds) != self.count:
      raise ValueError(f"{len(seeds)} seeds for {self.count} cars")
    self._rngs = [np.random.default_rng([seed, 1]) for seed in seeds]
    task, everyone = self.task, np.ones(self.count, dtype=bool)
    self._begun_at = np.zeros(self.count)  # m, arc length at which the present episodes began
    self._target = np.full(self.count, task.speed)  # m/s, to be held in them
    self._plant = car_batch(self.config.plant, *self._draw(everyone))
    self.linkage = Linkage(self.count, task.servo_delay, task.servo_lag, task.period, *self._draw_linkage(everyone))
    course, observer = Course(task.path, self._target, task.period), self.config.observer(seeds, task.period)
    self.cars = DrivenCars(course, self._plant, self.linkage, observer, self.config.speed_control, self._begun_at)
    self.episode_steps = np.zeros(self.count, dtype=np.int64)

  @property
  def signals(self) -> Array:
    """True, (N, 10)."""
    return self.cars.signals

  @property
  def steering(self) -> Array:
    """Commanded, rad, (N,)."""
    return self.cars.steering

  @property
  def past(self) -> Array:
    """Slow means of steering command and path curvature, rad and 1/m, (N, 2)."""
    return self.cars.past

  @property
  def recent(self) -> Recent:
    """The last second, value by value."""
    return self.cars.recent

  @property
  def errors(self) -> Errors:
    """Relative to the path, (2, N) each: as estimated, and true."""
    return self.cars.errors

  @property
  def arc_length(self) -> Array:
    """Arc length along the path, as estimated and true, m, (2, N)."""
    return self.cars.arc_length

  @property
  def observation(self) -> Array:
    """What the agent sees, (N, 4): m, m/s, rad, rad/s."""
    return self.errors.observation[ESTIMATED]

  @property
  def cross_track(self) -> Array:
    """True cross-track error, m, (N,)."""
    return self.errors.cross_track[TRUE]

  def snapshot(self) -> "Fleet":
    """The fleet as it is now, to go on from later: a copy that shares nothing that changes."""
    return copy.deepcopy(self)

  def restart(self, which: Mask) -> None:
    """New episodes for some cars, (N,)."""
    if not which.any():
      return
    self._plant.restart(which, *self._draw(which))
    self.linkage.restart(which, *self._draw_linkage(which))
    self.cars.restart(which, self._begun_at, self._target)
    self.episode_steps = np.where(which, 0, self.episode_steps)

  def expert(self) -> Array:
    """Steering angle the demonstrator would set now, rad, (N,); the present one where there is no demonstrator."""
    if self.config.demonstrator is None:
      return self.steering
    wanted = self.config.demonstrator(one_of(self.errors, self._judge), self.cars.speeds[self._judge])
    return np.clip(wanted, -self.task.lock, self.task.lock)

  def expert_action(self) -> Array:
    """Steering rate that brings the command to the demonstrator's angle, as far as the bound lets it, rad/s, (N,)."""
    wanted = (self.expert() - self.steering) / self.task.period
    return np.clip(wanted, -self.task.largest_rate, self.task.largest_rate)

  def step(self, action: Array) -> Outcome:
    """Drive one control period with steering rates (N,), rad/s. Cars whose episode ends must be restarted.

    A car whose rate is not a number holds its steering and is lost.
    """
    task = self.task
    asked = np.asarray(action, dtype=np.float64).reshape(self.count)
    rate = np.clip(asked, -task.largest_rate, task.largest_rate)
    expert = self.expert()
    self.cars.step(np.clip(self.steering + task.period * rate, -task.lock, task.lock))
    self.episode_steps = self.episode_steps + 1
    difference = self.steering - expert if self.config.demonstrator else np.zeros(self.count)
    judged = one_of(self.errors, self._judge)
    gone = self.cars.mute | ~np.isfinite(self.signals).all(axis=-1)
    cross_track = np.where(gone, np.nan, judged.cross_track)
    terms, lost = task.judge(cross_track, judged.heading, np.nan_to_num(rate), difference)
    over = (self.arc_length[TRUE] - self._begun_at >= task.distance) | (self.episode_steps >= task.longest)
    return Outcome(np.sum(list(terms.values()), axis=0), lost, over & ~lost, terms)

  @property
  def theta(self) -> Array:
    """Parameters of each car in its present episode, (N, P); a copy."""
    return self._theta.copy()

  @property
  def _judge(self) -> int:
    return TRUE if self.task.judged_by_truth else ESTIMATED

  def _draw(self, which: Mask) -> tuple[Array, Array]:
    """Parameters (N, P) and starts (N, 7) of the cars that begin; rows of the others keep their parameters."""
    if which.all():
      self._theta = np.tile(self.config.theta, (self.count, 1))
    start = np.zeros((self.count, len(START)))
    for i in np.flatnonzero(which):
      self._begun_at[i] = self.task.begins_at(self._rngs[i])
      self._target[i] = self.task.target(self._rngs[i])
      start[i] = self.task.start_state(self._rngs[i], self._begun_at[i], self._target[i])
      if self.config.spread and self._limits:
        self._theta[i] = self.config.spread.draw(self._limits, self.config.theta, self._rngs[i])
    return self._theta.copy(), start

  def _draw_linkage(self, which: Mask) -> tuple[Array, Array]:
    """Steering gain, -, and offset, rad, (N,), of the episodes that begin; nothing for the other cars."""
    gain, offset = np.ones(self.count), np.zeros(self.count)
    for i in np.flatnonzero(which):
      gain[i], offset[i] = self.task.linkage(self._rngs[i])
    return gain, offset
