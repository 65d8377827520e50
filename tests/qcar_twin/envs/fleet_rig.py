"""Small fleets for the tests of the environments, wired without the agents' package."""

import numpy as np

from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.envs.fleet import Fleet, FleetConfig
from qcar_twin.envs.task import TrackingTask
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.paths import path_named
from qcar_twin.sensors.suite import qcar_sensors
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

VEHICLE = Vehicle.load()
BICYCLE = Bicycle(VEHICLE)
CAR = BICYCLE.car(BICYCLE.parameters.nominal)


class Holding:
  """A proportional speed controller with memory enough to notice a missing restart."""

  def __init__(self, speed):
    self._sum = np.zeros_like(speed)

  def restart(self, which, speed):
    self._sum = np.where(which, 0.0, self._sum)

  def voltage(self, speed, target, period):
    self._sum = self._sum + (target - speed) * period
    return 0.62 + 4.0 * (target - speed) + 2.0 * self._sum


def twin():
  return Twin(VEHICLE, threads=1, substeps=2)


def make_fleet(seeds, plant="twin", sensed=True, path="s", demonstrator=None, spread=None, **task):
  """A fleet of len(seeds) cars."""
  make = twin if plant == "twin" else (lambda: Bicycle(VEHICLE)) if plant == "bicycle" else plant
  config = FleetConfig(
    make,
    make().parameters.nominal,
    Holding,
    demonstrator=demonstrator,
    sensors=qcar_sensors() if sensed else None,
    car=CAR,
    settings=FilterSettings(lidar_correlation=0.3, front_drive_share=0.5) if sensed else None,
    spread=spread,
  )
  return Fleet(TrackingTask(path_named(path), **task), config, list(seeds))


def actions(steps, cars, seed=0):
  """Smooth random steering rates, rad/s, (T, N), mild enough to stay on the path for a while."""
  rng = np.random.default_rng(seed)
  phase = rng.uniform(0.0, 2.0 * np.pi, cars)
  time = 0.01 * np.arange(steps)[:, None]
  return 0.6 * np.cos(2.0 * np.pi * 1.3 * time + phase) + 0.02 * rng.standard_normal((steps, cars))
