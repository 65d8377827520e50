"""Effects of wild cars: shapes of whole actuator maps, and what differs between sessions of one car."""

from __future__ import annotations

import numpy as np

from ..simulation import Simulation
from .base import Effect

DEGREE = np.pi / 180


class SteeringSaturation(Effect):
  """A servo that is too steep in the middle and gives up early, differently on either side:
  delta = g u / (1 + |g u / L|^3)^(1/3), g = 1 + 0.25 k, L = lock / k on the left, 1 + 0.15 k and lock / 1.4 k on the
  right."""

  id, subsystem, parameter, typical, unit = "steering_saturation", "steering", "steering_map", 1.0, "-"
  wild = True

  def begin(self, sim: Simulation) -> None:
    lock = sim.car.max_steering[self.columns]
    self.gain = np.array([1 + 0.25 * self.value, 1 + 0.15 * self.value])
    self.most = np.stack([lock / self.value, lock / (1.4 * self.value)])

  def act(self, sim: Simulation) -> None:
    wanted = sim.command[1, self.columns]
    side = (wanted < 0.0).astype(int)
    steep = self.gain[side] * wanted
    most = np.take_along_axis(self.most, side[None], axis=0)[0]
    wanted[:] = steep / np.cbrt(1.0 + np.abs(steep / most) ** 3)

  def truth(self) -> dict[str, float]:
    k = self.value
    gains = {"gain_left": 1 + 0.25 * k, "gain_right": 1 + 0.15 * k}
    return super().truth() | gains | {"share_of_lock_left": 1 / k, "share_of_lock_right": 1 / (1.4 * k)}


class DriveChopped(Effect):
  """A chopped supply without a freewheel path: the motor is on the pack for a share d of the time and open for the
  rest, so its back-EMF acts for about that share, a little more since currents take time to end: K w weighs
  1 - x (1 - d)^1.15."""

  id, subsystem, parameter, typical, unit = "drive_chopped", "drive", "drive_chopped", 1.0, "-"
  wild = True

  def act(self, sim: Simulation) -> None:
    c, d = self.columns, sim.dynamics
    duty = np.array([train.command == "duty" for train in sim.car.drivetrain])[c]
    supply = np.array([train.supply if train.command == "duty" else 4.0 for train in sim.car.drivetrain])[c]
    volts = sim.command[0, c]
    share = np.clip(np.abs(volts) / np.where(duty, 1.0, supply), 0.0, 1.0)
    mixed = 1.0 - min(self.value, 1.0) * (1.0 - share) ** 1.15
    # the same current at standstill, less of the back-EMF while open
    d.conduct[c] *= mixed
    volts /= np.maximum(mixed, 1e-3)


class SessionTrim(Effect):
  """The horn was put back differently before the second session: the trim of either half of the runs."""

  id, subsystem, parameter, typical, unit, signed = "session_trim", "steering", "trim", 1.5 * DEGREE, "rad", True
  catalogue, wild = False, True

  def begin(self, sim: Simulation) -> None:
    count = self.columns.stop - self.columns.start
    self.trim = np.where(np.arange(count) < (count + 1) // 2, self.value, -0.6 * self.value)

  def link(self, sim: Simulation) -> None:
    sim.road[self.columns] += self.trim

  def truth(self) -> dict[str, float]:
    return {"trim_morning": self.value, "trim_afternoon": -0.6 * self.value}
