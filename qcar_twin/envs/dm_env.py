"""The task as a dm_control environment, listed by name and usable in its viewer.

  from agents.learning.dm_suite import suite  # suite().names: path_tracking_s, _o, _infinity, _c
  dm_control.viewer.launch(suite().load("path_tracking_s"))

The fleet simulates; dm_control's physics only shows the car, posed from the fleet's signals, so that plant, sensors
and filter are the same as in the other environments.
"""

import collections
import difflib
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.envs.fleet import Fleet, Outcome
from qcar_twin.extras import extra
from qcar_twin.rendering.scene import Puppet, scene
from qcar_twin.vehicle.vehicle import Vehicle

with extra("The dm_control environment"):
  from dm_control import mujoco
  from dm_control.mujoco import wrapper
  from dm_control.rl import control
  from dm_env import specs

Array = NDArray[np.float64]
OBSERVATIONS = ("cross_track_error", "cross_track_rate", "heading_error", "heading_rate")  # m, m/s, rad, rad/s


class ShownCar(mujoco.Physics):
  """A car that is posed, not simulated; one step is one control period."""

  def step(self, nstep: int = 1) -> None:
    """Time passes; the fleet moves the car."""
    self.data.time += nstep * self.model.opt.timestep

  def show(self, puppet: Puppet, signals: Array, elapsed: float) -> None:
    """Put the car where signals, (10,), say it is."""
    puppet.pose(self.data.qpos, np.nan_to_num(signals), elapsed)
    self.forward()


class PathTracking(control.Task):
  """The task of a fleet of one car.

  Args:
    fleet: the environment owns it.
    physics: shows the car.
    vehicle: the car's numbers.
  """

  def __init__(self, fleet: Fleet, physics: ShownCar, vehicle: Vehicle):
    if fleet.count != 1:
      raise ValueError(f"a dm_control environment drives one car, not {fleet.count}")
    self.fleet = fleet
    self._puppet = Puppet(physics.model.ptr, vehicle)
    self._outcome: Outcome | None = None
    self._begun = False

  def initialize_episode(self, physics: ShownCar) -> None:
    """The first episode is the one the fleet was seeded for; later ones follow from its random streams."""
    if self._begun:
      self.fleet.restart(np.ones(1, dtype=bool))
    self._begun, self._outcome = True, None
    physics.show(self._puppet, self.fleet.signals[0], 0.0)

  def seed(self, seed: int) -> None:
    """Restart everything random; the next reset begins the seed's first episode."""
    self.fleet.seed([seed])
    self._begun = False

  def action_spec(self, physics: ShownCar) -> specs.BoundedArray:
    """Steering rate, rad/s."""
    largest = self.fleet.task.largest_rate
    return specs.BoundedArray((1,), np.float64, -largest, largest, name="steering_rate")

  def before_step(self, action: Array, physics: ShownCar) -> None:
    self._outcome = self.fleet.step(action)

  def after_step(self, physics: ShownCar) -> None:
    physics.show(self._puppet, self.fleet.signals[0], self.fleet.task.period)

  def get_observation(self, physics: ShownCar) -> Mapping[str, Array]:
    """The four errors by name, (1,) each."""
    values = self.fleet.observation[0]
    return collections.OrderedDict((name, values[i : i + 1].copy()) for i, name in enumerate(OBSERVATIONS))

  def get_reward(self, physics: ShownCar) -> float:
    assert self._outcome is not None
    return float(self._outcome.reward[0])

  def get_termination(self, physics: ShownCar) -> float | None:
    """Discount 0 for a lost car, 1 at the end of the path, None on the way."""
    assert self._outcome is not None
    if self._outcome.terminated[0]:
      return 0.0
    return 1.0 if self._outcome.truncated[0] else None


def environment(fleet: Fleet, vehicle: Vehicle | None = None, flat_observation: bool = False) -> control.Environment:
  """A dm_control environment around a fleet of one car.

  Args:
    vehicle: shown; the QCar without it.
    flat_observation: one array instead of four by name.
  """
  vehicle = vehicle or Vehicle.load()
  spec = scene(vehicle, fleet.task.path)
  spec.option.timestep = fleet.task.period
  physics = ShownCar.from_model(wrapper.MjModel(spec.compile()))
  return control.Environment(physics, PathTracking(fleet, physics, vehicle), flat_observation=flat_observation)


class Suite:
  """Environments by name, made when they are asked for."""

  def __init__(self, makers: Mapping[str, Callable[[int], Fleet]]):
    self._makers = dict(makers)

  @property
  def names(self) -> tuple[str, ...]:
    return tuple(self._makers)

  def load(self, name: str, seed: int = 0, flat_observation: bool = False) -> control.Environment:
    """The environment of a name, its random streams from a seed.

    Raises:
      KeyError: unknown name, with the nearest one.
    """
    if name not in self._makers:
      near = difflib.get_close_matches(name, self._makers, n=1) or self.names
      raise KeyError(f"no environment '{name}'; did you mean {', '.join(near)}?")
    return environment(self._makers[name](seed), flat_observation=flat_observation)
