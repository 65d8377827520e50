"""One effect at a time, on a car with as little else as possible."""

import dataclasses

import numpy as np

from calibration.concealed.proving_ground import EFFECTS, Car
from calibration.concealed.proving_ground.car import fleet, one_of
from calibration.concealed.proving_ground.simulation import Simulation

PLAIN = Car(copper=0.0, discharge=0.0)
FREE = dataclasses.replace(PLAIN, motor_coulomb=0.0, motor_viscous=0.0, rolling_resistance=0.0)


def effect(name: str, size: float = 1.0, columns: slice = slice(0, 1), seed: int = 0):
  return EFFECTS[name](size, columns, np.random.default_rng(seed))


def simulation(*effects, car: Car = PLAIN, n: int = 1, start=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)) -> Simulation:
  sim = Simulation(fleet([car], [n]), effects)
  sim.begin(np.tile(start, (n, 1)))
  return sim


def go(sim: Simulation, volts: float, steer: float, seconds: float) -> Simulation:
  for _ in range(round(seconds / 0.01)):
    sim.advance(np.array([[volts] * sim.n, [steer] * sim.n]))
  return sim


def changed(name: str, size: float = 1.0, car: Car = PLAIN) -> Car:
  """The car with what the effect does to its numbers."""
  columns = fleet([car], [1])
  effect(name, size).prepare(columns)
  return one_of(columns, 0)
