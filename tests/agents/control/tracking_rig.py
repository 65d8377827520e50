"""The QCar's nominal single track as plant and model of the controllers."""

import numpy as np

from agents.control.closed_loop import Actuation, Scenario, drive
from agents.control.speed import SpeedGains
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.estimation.observer import TrueObserver
from qcar_twin.paths import path_named
from qcar_twin.plant import COMMANDS
from qcar_twin.vehicle.drive import DRIVES


class Numbers:
  """Measured numbers of a car, cg ahead of the middle so that front and rear differ."""

  mass, yaw_inertia, cg_to_front, cg_to_rear = 2.7, 0.030, 0.120, 0.136
  wheel_radius, gear_ratio, max_steering, imu_x, imu_y = 0.033, 0.0953668, 0.5236, 0.0, 0.0
  motor, commands = DRIVES["voltage"], COMMANDS


PLANT = Bicycle(Numbers())
THETA = PLANT.parameters.vector({"cornering_stiffness_front": 150.0, "cornering_stiffness_rear": 210.0})
CAR = PLANT.car(THETA)


def follow(controller, path, count=1, observer=None, **task):
  """Drive a path on the true state (or with an observer)."""
  wanted = Scenario(path if not isinstance(path, str) else path_named(path), **task)
  return drive(
    PLANT, np.tile(THETA, (count, 1)), controller, SpeedGains.design(CAR), observer or TrueObserver(), wanted
  )


__all__ = ["CAR", "PLANT", "THETA", "Actuation", "follow"]
