"""N simulated cars of which any one can be put back to a start while the others drive on.

A plant begins all its cars together. Episodes end one by one; so a restarted car is begun alone and its state is
carried over, in one batch where the plant allows it, else every car is a simulation of its own.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.plant import SIGNALS, Plant, Simulation
from qcar_twin.twin import parameters as twin_parameters
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class CarBatch(Protocol):
  """N cars. `signals` is the present state, (N, 10)."""

  signals: Array

  def step(self, commands: Array) -> Array:
    """Hold commands (N, 2) for one control period; the signals after it, (N, 10)."""
    ...

  def restart(self, which: Mask, theta: Array, start: Array) -> None:
    """Put some cars, (N,), to starts (N, 7) with parameters (N, P); rows of the others are not looked at."""
    ...


class TwinBatch:
  """Cars of a twin, with whatever mechanisms, all in one simulation.

  Args:
    make: returns a new twin; two are made: one for the cars, one in which restarted cars are begun.
    theta, start: (N, P), (N, 7).
  """

  def __init__(self, make: Callable[[], Twin], theta: Array, start: Array):
    self._twin, self._nursery = make(), make()
    self._theta = np.array(theta, dtype=np.float64)
    self._simulation = self._twin.begin(self._theta, np.array(start))
    self.signals = self._simulation.signals

  def step(self, commands: Array) -> Array:
    return self._simulation.step(commands)

  def restart(self, which: Mask, theta: Array, start: Array) -> None:
    if np.any(theta[which] != self._theta[which]):
      self._theta[which] = theta[which]
      values = twin_parameters.quantities(self._theta, self._twin.base, self._twin.vehicle)
      self._simulation.reload(values, self._twin.slots(self._theta))
    for i in np.flatnonzero(which):
      source = self._nursery.batch(1) if self._twin.engine == "mujoco" else None
      self._simulation.adopt(int(i), self._nursery.begin(theta[i : i + 1], start[i : i + 1], batch=source))


class BicycleBatch:
  """Cars of the identified single track, side by side."""

  def __init__(self, bicycle: Bicycle, theta: Array, start: Array):
    self._bicycle = bicycle
    self._simulation = bicycle.begin(theta, start)
    self.signals = self._simulation.signals

  def step(self, commands: Array) -> Array:
    self.signals = self._simulation.step(commands)
    return self.signals

  def restart(self, which: Mask, theta: Array, start: Array) -> None:
    fresh, old = self._bicycle.begin(theta, np.where(which[:, None], start, 0.0)), self._simulation
    fresh.state = np.where(which[:, None], fresh.state, old.state)
    fresh.signals = np.where(which[:, None], fresh.signals, old.signals)
    self._simulation, self.signals = fresh, fresh.signals


class SeparateCars:
  """Cars of any plant, each a simulation of its own: slower, but nothing is asked of the plant.

  Args:
    make: returns a new plant; called once per car, since simulations of one plant may share memory.
  """

  def __init__(self, make: Callable[[], Plant], theta: Array, start: Array):
    self._plants = [make() for _ in theta]
    self._simulations: list[Simulation] = [
      plant.begin(theta[i : i + 1], start[i : i + 1]) for i, plant in enumerate(self._plants)
    ]
    self.signals = np.empty((len(theta), len(SIGNALS)))
    for i, simulation in enumerate(self._simulations):
      self.signals[i] = simulation.signals[0]

  def step(self, commands: Array) -> Array:
    for i, simulation in enumerate(self._simulations):
      self.signals[i] = simulation.step(commands[i : i + 1])[0]
    return self.signals

  def restart(self, which: Mask, theta: Array, start: Array) -> None:
    for i in np.flatnonzero(which):
      self._simulations[i] = self._plants[i].begin(theta[i : i + 1], start[i : i + 1])
      self.signals[i] = self._simulations[i].signals[0]


def car_batch(make: Callable[[], Plant], theta: Array, start: Array) -> CarBatch:
  """The fastest batch of what `make` makes."""
  plant = make()
  if isinstance(plant, Bicycle):
    return BicycleBatch(plant, theta, start)
  if isinstance(plant, Twin):
    return TwinBatch(make, theta, start)  # type: ignore[arg-type]
  return SeparateCars(make, theta, start)
