"""The electronics between the drive command and the motor: bridge or VESC.

A VESC keeps the motor's current by itself; given a speed, its loop sets that current a thousand times a second:
  i = k_p e + q, q' = k_i e while |i| is below the limit, e = s v - w (s motor speed per speed asked for).
The pack bounds what flows: |K w + R i| <= its voltage.
"""

from __future__ import annotations

import numpy as np

from .drivetrain import AXLES, Drivetrain
from .dynamics import Dynamics


class Electronics:
  """The VESCs of those of N cars that are not given a voltage."""

  def __init__(self, dynamics: Dynamics, trains: list[Drivetrain]) -> None:
    self.dynamics = dynamics
    column = lambda name: np.array([getattr(train, name) for train in trains])
    kind = column("command")
    self.duty, self.current, self.speed = (kind == name for name in ("duty", "current", "speed"))
    self.idle = not np.any(kind != "voltage")
    self.supply, self.limit = column("supply"), column("max_current")
    self.proportional, self.integral, self.motor_per_speed = map(
      column, ("proportional", "integral", "motor_per_speed")
    )
    self.memory = np.zeros(len(trains))
    driven = np.array([AXLES[train.layout] for train in trains]).T
    if np.any(driven == 0.0):
      dynamics.driven = driven
    if np.any(self.current | self.speed):
      dynamics.regulated = self.current | self.speed

  def begin(self) -> None:
    """The speed loop has settled at the speed the cars start with."""
    d, car = self.dynamics, self.dynamics.car
    friction = car.motor_coulomb * d.state.bristle + car.motor_viscous * d.state.motor
    self.memory[:] = friction / d.constant

  def apply(self, command: np.ndarray, left: np.ndarray, h: float) -> None:
    """From drive commands (N,) to voltage or current of the motor, for h seconds; `left` (N,) of the pack's voltage."""
    if self.idle:
      return
    d, pack = self.dynamics, self.supply * left
    d.voltage[self.duty] = (np.clip(command, -1.0, 1.0) * pack)[self.duty]
    error = self.motor_per_speed * command - d.state.motor
    wish = self.proportional * error + self.memory
    free = (np.abs(wish) < self.limit) | (np.sign(error) != np.sign(wish))
    self.memory += np.where(self.speed & free, self.integral * error * h, 0.0)
    wish = np.clip(np.where(self.speed, wish, command), -self.limit, self.limit)
    back = d.constant * d.state.motor
    d.demand[:] = np.clip(wish, (-pack - back) / d.resistance, (pack - back) / d.resistance)
    regulated = self.current | self.speed
    d.voltage[regulated] = (back + d.resistance * d.demand)[regulated]
