"""Speed, in pairs: both sides of a comparison take turns in one run, so that what else the machine does hits both.

A ratio is the median of the ratios of the rounds; times are medians. What runs on one thread is timed by the
processor's time it takes, which other work on the machine hardly changes; threads and fits by the clock on the wall.
"""

import dataclasses
import time
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from qcar_twin.plant import START
from qcar_twin.twin.simulation import mujoco_batch
from qcar_twin.twin.timers import timers_stopped
from qcar_twin.twin.twin import Simulation, Twin
from qcar_twin.vehicle.mjcf import car_model
from qcar_twin.vehicle.vehicle import QCAR, TyreKind

Array = NDArray[np.float64]

STEPS = 500  # simulation steps of 2 ms a measurement of one car takes
CARS = 256  # side by side where a batch is measured
PERIODS = 5  # control periods of 10 ms a measurement of a batch takes
_SETTLING = 1.0  # s of driving before anything is measured
TURNS = ((1.4, 0.2), (2.0, 0.2), (1.4, 0.3))  # motor voltage [V] and steering [rad]
_TURN = TURNS[0]
_SPEED = 1.5  # m/s


@dataclasses.dataclass(frozen=True)
class Pair:
  """Two timings that belong together.

  Attributes:
    name: what was compared.  sides: names of the two.
    seconds: median time of each, per `unit` of work.  unit: that work.
    ratio: median of first / second.  goal: what the ratio should reach; `at_most` tells which way.
  """

  name: str
  sides: tuple[str, str]
  seconds: tuple[float, float]
  unit: str
  ratio: float
  goal: float
  at_most: bool = True
  note: str = ""

  @property
  def reached(self) -> bool:
    """Whether the goal was met."""
    return self.ratio <= self.goal if self.at_most else self.ratio >= self.goal

  @property
  def aim(self) -> str:
    """The goal in words."""
    return f"{'<=' if self.at_most else '>='} {self.goal:g}"

  def __str__(self) -> str:
    first, second = (f"{1e6 * s:.4g} us" for s in self.seconds)
    return (
      f"{self.name}: {self.sides[0]} {first}, {self.sides[1]} {second} per {self.unit};"
      f" ratio {self.ratio:.3g} (goal {self.aim}: {'reached' if self.reached else 'MISSED'})"
      f"{'; ' + self.note if self.note else ''}"
    )


def paired(
  first: Callable[[], object],
  second: Callable[[], object],
  rounds: int,
  clock: Callable[[], float] = time.perf_counter,
) -> tuple[float, float, float]:
  """Median seconds of both and median ratio first / second; the order swaps from round to round."""
  times = np.empty((rounds, 2))
  for side in (first, second):
    side()  # whatever is made on first use is made
  for k in range(rounds):
    order = (0, 1) if k % 2 == 0 else (1, 0)
    for side in order:
      began = clock()
      (first, second)[side]()
      times[k, side] = clock() - began
  return float(np.median(times[:, 0])), float(np.median(times[:, 1])), float(np.median(times[:, 0] / times[:, 1]))


def tyre_pairs(rounds: int = 21) -> tuple[Pair, ...]:
  """A 2 ms step in turns: the tyre in the contact solver against MuJoCo's own friction."""
  return tuple(_tyre_pair(turn, rounds) for turn in TURNS)


def _tyre_pair(turn: tuple[float, float], rounds: int) -> Pair:
  with timers_stopped():
    ours, _ = _turning_car("contact", turn)
    theirs, across = _turning_car("native", turn)
    first, second, ratio = paired(ours, theirs, rounds, time.process_time)
  seconds = (first / STEPS, second / STEPS)
  name = f"2 ms step of one car in a turn of {across:.1f} m/s^2"
  return Pair(name, ("tyre plugin", "native friction"), seconds, "step", ratio, 0.8)


def _turning_car(tyre: TyreKind, turn: tuple[float, float]) -> tuple[Callable[[], None], float]:
  """STEPS steps of a car that already turns, from the same state at every call; and its lateral acceleration, m/s^2."""
  model = car_model(QCAR, tyre)
  data = mujoco.MjData(model)
  data.ctrl[:] = turn
  mujoco.mj_step(model, data, nstep=int(2.0 / model.opt.timestep))
  kind = mujoco.mjtState.mjSTATE_INTEGRATION
  state = np.empty(mujoco.mj_stateSize(model, kind))
  mujoco.mj_getState(model, data, state, kind)

  def drive() -> None:
    mujoco.mj_setState(model, data, state, kind)
    mujoco.mj_step(model, data, nstep=STEPS)

  return drive, float(np.hypot(*data.qvel[:2]) * data.qvel[5])


def overhead_pair(rounds: int = 41, cars: int = CARS) -> Pair:
  """10 ms of many cars: the twin's step against the bare steps of the batch inside it."""
  twin = Twin(QCAR, threads=1)
  simulation, commands = _turning_cars(twin, cars)
  batch = mujoco_batch(simulation)
  bare = lambda: [batch.step(nstep=twin.substeps) for _ in range(PERIODS)]
  with timers_stopped():
    first, second, ratio = paired(lambda: _drive(simulation, commands), bare, rounds, time.process_time)
  seconds = (first / PERIODS / cars, second / PERIODS / cars)
  return Pair(f"10 ms of {cars} cars", ("Simulation.step", "bare batch.step"), seconds, "car", ratio, 1.15)


def _drive(simulation: Simulation, commands: Array) -> None:
  for _ in range(PERIODS):
    simulation.step(commands)


def threads_pair(rounds: int = 21, cars: int = CARS) -> Pair:
  """The same batch on one thread and on two."""
  with timers_stopped():
    sides = [_turning_cars(Twin(QCAR, threads=n), cars) for n in (1, 2)]
    first, second, ratio = paired(lambda: _drive(*sides[0]), lambda: _drive(*sides[1]), rounds)
  seconds = (first / PERIODS / cars, second / PERIODS / cars)
  note = "needs two idle cores"
  return Pair(f"10 ms of {cars} cars", ("one thread", "two threads"), seconds, "car", ratio, 1.8, False, note)


def _turning_cars(twin: Twin, cars: int) -> tuple[Simulation, Array]:
  """Cars under way in a turn, each with its own tyres."""
  rng = np.random.default_rng(0)
  theta = np.tile(twin.parameters.nominal, (cars, 1))
  stiffness = twin.parameters.index("cornering_stiffness_front")
  theta[:, stiffness] *= rng.uniform(0.8, 1.2, cars)
  start = np.zeros((cars, len(START)))
  start[:, START.index("velocity_x")] = _SPEED
  simulation = twin.begin(theta, start)
  commands = np.tile(_TURN, (cars, 1))
  for _ in range(int(_SETTLING / twin.period)):
    simulation.step(commands)
  return simulation, commands
