"""Effects of motor, battery and electronics."""

from __future__ import annotations

import numpy as np

from ..simulation import Simulation
from .base import Effect, towards
from .steering import SteeringDelay


class DriveDeadZone(Effect):
  """The bridge swallows a voltage, with a soft knee."""

  id, subsystem, parameter, typical, unit = "drive_dead_zone", "drive", "drive_dead_zone", 0.15, "V"

  def act(self, sim: Simulation) -> None:
    volts, soft = sim.command[0, self.columns], 0.12 * self.value
    up, down = np.logaddexp(0, (volts - self.value) / soft), np.logaddexp(0, (-volts - self.value) / soft)
    volts[:] = soft * (up - down)


class DriveLag(Effect):
  """Two unequal smoothing stages in the motor electronics; parameter: the sum of their time constants."""

  id, subsystem, parameter, typical, unit = "drive_lag", "drive", "drive_lag", 0.10, "s"

  def begin(self, sim: Simulation) -> None:
    self.first, self.second = np.repeat(sim.command[:1, self.columns], 2, axis=0)

  def act(self, sim: Simulation) -> None:
    volts = sim.command[0, self.columns]
    self.first = towards(self.first, volts, sim.h, 0.75 * self.value)
    self.second = towards(self.second, self.first, sim.h, 0.25 * self.value)
    volts[:] = self.second


class DriveDelay(SteeringDelay):
  """The voltage waits in a ring of fine steps."""

  id, subsystem, parameter, typical, unit = "drive_delay", "drive", "drive_delay", 0.035, "s"
  row = 0


class BatterySag(Effect):
  """The pack gives way under power p (a quick, 10 ms, and a slow part, 1.5 s; 1 at stall with 2.5 V): V / (1 + s p)."""

  id, subsystem, parameter, typical, unit = "battery_sag", "drive", "battery_sag", 0.30, "-"

  def begin(self, sim: Simulation) -> None:
    self.quick, self.slow = np.zeros((2, sim.n))[:, self.columns]

  def act(self, sim: Simulation) -> None:
    c = self.columns
    stall = 2.5**2 / sim.car.motor_resistance[c]
    power = np.maximum(sim.command[0, c] * sim.dynamics.current[c], 0.0) / stall
    self.quick = towards(self.quick, power, sim.h, 0.010)
    self.slow = towards(self.slow, power, sim.h, 1.5)
    sim.command[0, c] /= 1 + self.value * (0.65 * self.quick + 0.35 * self.slow)


class BatteryDischarge(Effect):
  """The pack's voltage falls with the charge taken over the session, faster towards its end."""

  id, subsystem, parameter, typical, unit = "battery_discharge", "drive", "discharge", 0.10, "-"

  def act(self, sim: Simulation) -> None:
    c = self.columns
    empty = sim.used[c] / sim.carried.session_charge[c]
    sim.command[0, c] *= 1 - self.value * (empty + 0.5 * empty**3) / 1.5


class MotorHeating(Effect):
  """Magnets weaken as the motor warms over a minute: K = K_0 / (1 + g x), x = 1 at the session's mean loss."""

  id, subsystem, parameter, typical, unit = "motor_heating", "drive", "motor_fade", 0.15, "-"
  MEMORY = 60.0  # s

  def begin(self, sim: Simulation) -> None:
    self.warmth = 1 - np.exp(-sim.carried.elapsed[self.columns] / (4 * self.MEMORY))

  def act(self, sim: Simulation) -> None:
    d, c = sim.dynamics, self.columns
    loss = d.current[c] ** 2 * d.resistance[c] / sim.carried.session_loss[c]
    self.warmth = towards(self.warmth, loss, sim.h, self.MEMORY)
    d.constant[c] /= 1 + self.value * self.warmth


class CoastFreewheel(Effect):
  """The bridge opens 4 ms after the command has gone to nothing; parameter: the share of the current it stops."""

  id, subsystem, parameter, typical, unit = "coast_freewheel", "drive", "coast_freewheel", 0.7, "-"

  def begin(self, sim: Simulation) -> None:
    self.idle = np.zeros(sim.n)[self.columns]

  def act(self, sim: Simulation) -> None:
    c = self.columns
    nothing = np.abs(sim.command[0, c]) < 0.01
    self.idle = np.where(nothing, self.idle + sim.h, 0.0)
    sim.dynamics.conduct[c] *= np.where(self.idle > 4e-3, 1 - min(self.value, 1.0), 1.0)


class DriveAsymmetry(Effect):
  """The bridge's lower half is weaker: negative voltages arrive reduced by a share."""

  id, subsystem, parameter, typical, unit, signed = "drive_asymmetry", "drive", "drive_asymmetry", 0.10, "-", True

  def act(self, sim: Simulation) -> None:
    volts = sim.command[0, self.columns]
    volts *= 1 - self.value / (1 + np.exp(np.clip(volts / 0.01, -40, 40)))

  def truth(self) -> dict[str, float]:
    """Canonically, how much stronger backwards than forwards."""
    return {self.parameter: -self.value}


class Cogging(Effect):
  """A gear out of true: torque that ripples n times a turn of the wheels (n from 2 to 5), with an overtone of 1/4."""

  id, subsystem, parameter, typical, unit = "cogging", "drive", "cogging_torque", 2.5e-3, "N m"

  def choose(self, rng: np.random.Generator) -> None:
    self.order, self.phase = int(rng.integers(2, 6)), rng.uniform(0, 2 * np.pi)

  def load(self, sim: Simulation) -> None:
    c = self.columns
    angle = self.order * sim.car.gear_ratio[c] * sim.dynamics.stage.motor_angle[c] + self.phase
    moving = np.tanh(np.abs(sim.dynamics.stage.motor[c]) / 5.0)
    sim.dynamics.motor_torque[c] += self.value * moving * (np.sin(angle) + 0.25 * np.sin(2 * angle + 0.7))

  def truth(self) -> dict[str, float]:
    return super().truth() | {"cogging_order": float(self.order)}
