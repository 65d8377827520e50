"""Effects that the diagnosis has no name for: they must come out as unknown."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ..sensing import Log
from ..simulation import Simulation
from .base import Effect, towards


class Outside(Effect):
  """Base of the effects outside the catalogue; `carried_by`: what its formula is a function of, one or more of
  motion, commands, heading, place, history, rhythm, bursts."""

  catalogue = False
  carried_by: ClassVar[tuple[str, ...]]


class YawDrag(Outside):
  """Turning the car drags on the drive: F = -c abs(yaw rate) tanh(v / 0.05)."""

  id, subsystem, parameter, typical, unit = "yaw_drag", "drive", "drag_per_yaw_rate", 1.2, "N s/rad"
  carried_by = ("motion",)

  def load(self, sim: Simulation) -> None:
    s, c = sim.dynamics.stage, self.columns
    sim.dynamics.wrench[0, c] -= self.value * np.abs(s.yaw_rate[c]) * np.tanh(s.vx[c] / 0.05)


class GyroMagnet(Outside):
  """Steel under the floor bends the gyro's reading near one place."""

  id, subsystem, parameter, typical, unit, signed = "gyro_magnet", "sensor", "disturbance", 0.12, "rad/s", True
  carried_by = ("place",)

  def choose(self, rng: np.random.Generator) -> None:
    self.centre = rng.uniform(-0.8, 0.8, 2)

  def sense(self, log: Log) -> None:
    c = self.columns
    off = (log.state("x")[:, c] - self.centre[0]) ** 2 + (log.state("y")[:, c] - self.centre[1]) ** 2
    log.channels["yaw_rate"][:, c] += self.value / (1 + off**2 / 0.8**4)

  def truth(self) -> dict[str, float]:
    return super().truth() | {"x": float(self.centre[0]), "y": float(self.centre[1])}


class TorqueSteer(Outside):
  """Drive torque pulls the wheels aside through a linkage that rubs: play in current, then an angle."""

  id, subsystem, parameter, typical, unit, signed = "torque_steer", "steering", "angle_per_current", 6e-3, "rad/A", True
  carried_by = ("commands", "motion")

  def begin(self, sim: Simulation) -> None:
    self.memory = np.zeros(sim.n)[self.columns]

  def link(self, sim: Simulation) -> None:
    current = sim.dynamics.current[self.columns]
    self.memory = np.clip(self.memory, current - 1.0, current + 1.0)
    sim.road[self.columns] += self.value * 8.0 * np.tanh(self.memory / 8.0)


class SteeringShimmy(Outside):
  """The steered wheels swing at 4.2 Hz, more and more with speed."""

  id, subsystem, parameter, typical, unit = "steering_shimmy", "steering", "swing_at_1.5m/s", 0.015, "rad"
  carried_by = ("rhythm",)

  def link(self, sim: Simulation) -> None:
    v = sim.dynamics.state.vx[self.columns]
    sim.road[self.columns] += self.value * (v / 1.5) ** 2 * np.sin(2 * np.pi * 4.2 * sim.time)


class TyreTemperature(Outside):
  """Tyres that warm by sliding lose grip and forget it over eight seconds."""

  id, subsystem, parameter, typical, unit = "tyre_temperature", "tyre", "grip_lost_at_1W", 0.8, "-"
  carried_by = ("history",)

  def begin(self, sim: Simulation) -> None:
    self.warmth = np.zeros((4, sim.n))[:, self.columns]

  def act(self, sim: Simulation) -> None:
    d, c = sim.dynamics, self.columns
    power = np.abs(d.force[0, :, c] * d.slide[0, :, c]) + np.abs(d.force[1, :, c] * d.slide[1, :, c])
    self.warmth = towards(self.warmth, power, sim.h, 8.0)
    d.grip[:, c] *= 1 - 0.8 * np.tanh(self.value * self.warmth / 0.8)


class SideWind(Outside):
  """A fan across the room: force with the square of the relative air speed, in the world frame."""

  id, subsystem, parameter, typical, unit = "side_wind", "body", "force_at_rest", 0.6, "N"
  carried_by = ("heading",)
  WIND = 3.0  # m/s

  def choose(self, rng: np.random.Generator) -> None:
    angle = rng.uniform(-np.pi, np.pi)
    self.wind = self.WIND * np.array([np.cos(angle), np.sin(angle)])

  def load(self, sim: Simulation) -> None:
    s, c, wrench = sim.dynamics.stage, self.columns, sim.dynamics.wrench
    cos, sin = np.cos(s.yaw[c]), np.sin(s.yaw[c])
    air_x = cos * self.wind[0] + sin * self.wind[1] - s.vx[c]
    air_y = cos * self.wind[1] - sin * self.wind[0] - s.vy[c]
    push = self.value / self.WIND**2 * np.hypot(air_x, air_y) * np.tanh(np.abs(s.motor[c]) / 20.0)
    wrench[0, c] += 0.4 * push * air_x
    wrench[1, c] += push * air_y
    wrench[2, c] += 0.03 * push * air_y

  def truth(self) -> dict[str, float]:
    return super().truth() | {"wind_x": float(self.wind[0]), "wind_y": float(self.wind[1])}


class WheelImbalance(Outside):
  """A wheel out of balance shakes the car once a turn, with the square of its speed."""

  id, subsystem, parameter, typical, unit = "wheel_imbalance", "drive", "imbalance", 5e-4, "kg m"
  carried_by = ("rhythm",)

  def load(self, sim: Simulation) -> None:
    s, c, wrench = sim.dynamics.stage, self.columns, sim.dynamics.wrench
    push = self.value * s.wheel_fl[c] ** 2
    angle = s.motor_angle[c] * sim.car.gear_ratio[c]
    wrench[0, c] += push * np.sin(angle)
    wrench[2, c] -= push * np.sin(angle) * sim.dynamics.wheel_y[0, c]


class AccelSaturation(Outside):
  """The accelerometer flattens out: a / (1 + (a / a_0)^2)^(1/2), 1 / a_0 being the parameter."""

  id, subsystem, parameter, typical, unit = "accel_saturation", "sensor", "inverse_ceiling", 0.25, "s^2/m"
  carried_by = ("motion",)

  def sense(self, log: Log) -> None:
    for name in ("accel_x", "accel_y"):
      reading = log.channels[name][:, self.columns]
      reading /= np.sqrt(1 + (self.value * reading) ** 2)


class RadioDropout(Outside):
  """The radio loses words: now and then both commands stay put for 0.15 to 0.3 s; parameter: mean losses per second."""

  id, subsystem, parameter, typical, unit = "radio_dropout", "command", "losses_per_second", 0.4, "1/s"
  carried_by = ("bursts",)

  def begin(self, sim: Simulation) -> None:
    self.kept = sim.command[:, self.columns].copy()
    self.until = np.full(sim.n, -1.0)[self.columns]
    self.dice = np.random.default_rng(self.rng.integers(2**32))

  def act(self, sim: Simulation) -> None:
    command = sim.command[:, self.columns]
    lucky = self.dice.random(len(self.until)) >= self.value * sim.h
    length = self.dice.uniform(0.15, 0.30, len(self.until))
    self.until = np.where(lucky | (self.until > sim.time), self.until, sim.time + length)
    self.kept = np.where(self.until > sim.time, self.kept, command)
    command[:] = self.kept


class CarpetPile(Outside):
  """A carpet's pile: drag that changes with twice the heading."""

  id, subsystem, parameter, typical, unit = "carpet_pile", "ground", "drag", 0.8, "N"
  carried_by = ("heading",)

  def choose(self, rng: np.random.Generator) -> None:
    self.grain = rng.uniform(0, np.pi)

  def load(self, sim: Simulation) -> None:
    s, c = sim.dynamics.stage, self.columns
    along = np.cos(2 * (s.yaw[c] - self.grain))
    sim.dynamics.wrench[0, c] -= self.value * along * np.tanh(s.vx[c] / 0.05)

  def truth(self) -> dict[str, float]:
    return super().truth() | {"grain": float(self.grain)}
