"""A controller of the shipped file as a demonstrator, whose steering angle a reward compares with."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from agents.control import controllers
from agents.control.interface import Controller, Situation
from agents.control.linear_rate import LinearRate
from agents.control.model import Model
from qcar_twin.paths import Errors
from qcar_twin.paths import Path as Course

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Expert:
  """A controller as a demonstrator on a path."""

  controller: Controller
  path: Course

  def __call__(self, errors: Errors, speed: Array) -> Array:
    """Its steering angle, rad, (N,)."""
    zero = np.zeros_like(speed)
    return self.controller.steer(Situation(self.path, zero, errors, speed, zero, 0.01))


def expert(name: str, version: str, path: Course, speed: float, model: Model) -> Expert:
  """The controller of this name and version, designed for a speed, m/s, as a demonstrator on a path.

  Raises:
    KeyError: no such controller or version.
    ValueError: one that answers to the steering angle it left behind, which is not its own here.
  """
  table = controllers.entries()
  if version not in table.get(name, {}):
    known = ", ".join(f"{one} {v}" for one, versions in table.items() for v in versions)
    raise KeyError(f"no controller '{name} {version}' to learn from; there are {known}")
  controller = controllers.make(name, table[name][version], model.car, speed, model.vehicle.max_steering)
  if isinstance(controller, LinearRate):
    others = ", ".join(one for one in table if one != name)
    raise ValueError(
      f"{name} adds to the steering angle that it commanded before, so it answers nothing to another's driving;"
      f" demonstrators are {others}"
    )
  return Expert(controller, path)
