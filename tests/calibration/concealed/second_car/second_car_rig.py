"""Cars of different numbers side by side through one manoeuvre."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from calibration.concealed.laboratory.manoeuvres import PERIOD
from calibration.concealed.second_car.car import SecondCar
from calibration.concealed.second_car.effects import conceal
from calibration.concealed.second_car.floor import Floor
from calibration.concealed.second_car.simulation import TOLERANCE, Simulation, columns, energy

CAR = SecondCar()


def changed(name: str, size: float = 1.0, car: SecondCar = CAR) -> SecondCar:
  """The car with one effect."""
  return conceal(car, ((name, size),), np.random.default_rng(3))[0]


def side_by_side(cars: Sequence[SecondCar]) -> SimpleNamespace:
  """Columns, one for each car; springs are those of the bare one."""
  each = [vars(columns(car, 1, CAR.mass)) for car in cars]
  return SimpleNamespace(**{name: np.concatenate([table[name] for table in each]) for name in each[0]})


def go(
  cars: Sequence[SecondCar],
  command: Callable[[float], tuple],
  duration: float,
  speed: float | Sequence[float] = 0.0,
  steer: float = 0.0,
  tolerance: float = TOLERANCE,
  level: float = 0.0,
) -> tuple[Simulation, np.ndarray]:
  """The simulation at its end and its energy at every tick (T + 1, n) [J].

  `command`: time -> voltage and steering, numbers or (n,); `speed` at the start, in the turn that `steer` makes.
  """
  ticks, n = round(duration / PERIOD), len(cars)
  table = side_by_side(cars)
  start = np.zeros((n, 7))
  start[:, 3], start[:, 6] = speed, steer
  start[:, 5] = start[:, 3] * np.tan(steer) / (table.cg_to_front + table.cg_to_rear)
  start[:, 4] = start[:, 5] * table.cg_to_rear
  wanted = np.stack([np.stack(np.broadcast_arrays(*command(PERIOD * k), np.zeros(n))[:2]) for k in range(ticks)])
  floor = Floor(np.random.default_rng(5), level)
  simulation = Simulation(table, floor, start, wanted[0], ticks, np.random.default_rng(6), tolerance)
  stored = [energy(simulation)]
  for row in wanted:
    simulation.advance(row, np.zeros((3, n)))
    stored.append(energy(simulation))
  return simulation, np.array(stored)


FREE = replace(
  CAR, gear_friction=1e-12, rolling_resistance=0.0, drag=0.0, motor_viscous=0.0, motor_constant=1e-9, grease_axle=0.0,
  grease_centre=0.0,
)  # fmt: skip
