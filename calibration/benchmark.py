"""Speed in pairs: both sides of every ratio run in turn in one process, and medians are compared."""

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from qcar_twin.twin import Simulation, Twin
from qcar_twin.tyre.measure import step_times
from qcar_twin.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Pair:
  """Two things timed in turn, and the ratio of their medians.

  Attributes:
    name: what is compared.  ours, theirs: median times, s.  aim: what the ratio should be at most.
  """

  name: str
  ours: float
  theirs: float
  aim: float

  @property
  def ratio(self) -> float:
    return self.ours / self.theirs


def tyre_against_native(rounds: int = 40) -> Pair:
  """One 2 ms step in a turn: the tyre plugin against MuJoCo's own friction."""
  times = step_times(rounds=rounds)["turn"]
  return Pair(
    "2 ms step in a turn, tyre plugin / native friction", 1e-6 * times["contact"], 1e-6 * times["native"], 0.8
  )


def control_period_against_steps(cars: int = 256, rounds: int = 60) -> Pair:
  """10 ms of many cars through the twin against the bare batch steps it contains."""
  simulation = under_way(Twin(Vehicle.load(), threads=1), cars)
  commands = np.tile([1.5, 0.1], (cars, 1))
  batch = simulation.batch
  ours, theirs = in_turn(lambda: simulation.step(commands), lambda: batch.step(nstep=5), rounds)
  return Pair(f"10 ms of {cars} cars, twin / bare steps", ours, theirs, 1.15)


def threads(cars: int = 256, rounds: int = 60) -> Pair:
  """10 ms of many cars on two threads against one: at most 1 / 1.8."""
  two, one = (under_way(Twin(Vehicle.load(), threads=n), cars) for n in (2, 1))
  commands = np.tile([1.5, 0.1], (cars, 1))
  ours, theirs = in_turn(lambda: two.step(commands), lambda: one.step(commands), rounds)
  return Pair(f"10 ms of {cars} cars, two threads / one", ours, theirs, 1 / 1.8)


def under_way(twin: Twin, cars: int) -> Simulation:
  """Cars in a steady turn."""
  start = np.zeros((cars, 7))
  start[:, 3] = 1.0
  simulation = twin.begin(np.tile(twin.parameters.nominal, (cars, 1)), start)
  for _ in range(100):
    simulation.step(np.tile([1.5, 0.1], (cars, 1)))
  return simulation


def in_turn(one: Callable[[], object], other: Callable[[], object], rounds: int) -> tuple[float, float]:
  """Median times of two calls that take turns, s."""
  spent: tuple[list[float], list[float]] = ([], [])
  for _ in range(rounds):
    for call, times in zip((one, other), spent, strict=True):
      begin = time.perf_counter()
      call()
      times.append(time.perf_counter() - begin)
  return float(np.median(spent[0])), float(np.median(spent[1]))
