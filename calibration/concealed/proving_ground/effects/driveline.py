"""Effects of gears, shafts, wheels and of what the car carries: friction, drag, mass."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from ..simulation import Simulation
from .base import Effect


class CoulombFriction(Effect):
  """Seized bearings: a torque against each wheel, (2/pi) arctan of its speed; parameter: its force on the car."""

  id, subsystem, parameter, typical, unit = "coulomb_friction", "drive", "coulomb_friction", 1.0, "N"

  def load(self, sim: Simulation) -> None:
    d, c = sim.dynamics, self.columns
    torque = 0.25 * self.value * sim.car.wheel_radius[c]
    d.wheel_torque[:, c] -= torque * (2 / np.pi) * np.arctan(d.stage.wheel[:, c] / 0.15)


class WheelDrag(Effect):
  """A brake rubs on one wheel: a torque against it that fades below 1 rad/s; positive on the left."""

  id, subsystem, parameter, typical, unit, signed = "wheel_drag", "drive", "wheel_drag", 0.8, "N", True

  def choose(self, rng: np.random.Generator) -> None:
    self.wheel = 2 * int(rng.integers(2)) + int(self.value < 0.0)

  def load(self, sim: Simulation) -> None:
    d, c = sim.dynamics, self.columns
    torque = abs(self.value) * sim.car.wheel_radius[c]
    d.wheel_torque[self.wheel, c] -= torque * np.tanh(d.stage.wheel[self.wheel, c])


class Stiction(Effect):
  """Grease that sets: a bristle holds the motor till it turns, its hold fading: 1 / (1 + (v / v_s)^2), v_s 0.12 m/s."""

  id, subsystem, parameter, typical, unit = "stiction", "drive", "stiction_force", 0.7, "N"

  def load(self, sim: Simulation) -> None:
    d, c, car = sim.dynamics, self.columns, sim.car
    lever = car.gear_ratio[c] * car.wheel_radius[c]
    hold = self.value * lever / (1 + (d.stage.motor[c] * lever / 0.12) ** 2)
    d.motor_torque[c] -= hold * d.stage.bristle[c]


class SteeringDrag(Effect):
  """Universal joints bind in a turn: F = c (sqrt(delta^2 + e^2) - e), e = 0.03 rad, at the front wheels."""

  id, subsystem, parameter, typical, unit = "steering_drag", "drive", "steering_drag", 2.0, "N"

  def load(self, sim: Simulation) -> None:
    d, c = sim.dynamics, self.columns
    angle, spin = d.stage.servo[c] + d.bend[c], d.stage.wheel[:2, c]
    force = self.value * (np.sqrt(angle**2 + 0.03**2) - 0.03)
    d.wheel_torque[:2, c] -= 0.5 * force * sim.car.wheel_radius[c] * spin / np.sqrt(spin**2 + 0.25)


class DifferentialLock(Effect):
  """Preloaded clutch packs: a torque that rises to its limit over 0.8 rad/s of difference between left and right."""

  id, subsystem, parameter, typical, unit = "differential_lock", "drive", "lock_torque", 0.04, "N m"

  def load(self, sim: Simulation) -> None:
    d, c = sim.dynamics, self.columns
    wheel = d.stage.wheel[:, c]
    torque = self.value * np.tanh((wheel[0::2] - wheel[1::2]) / 0.8)
    d.wheel_torque[0::2, c] -= 0.5 * torque
    d.wheel_torque[1::2, c] += 0.5 * torque


class QuadraticDrag(Effect):
  """Drag of a stirred fluid film, F = c v_1^0.25 abs(v)^1.75 with v_1 = 1.5 m/s: equal to c v^2 there."""

  id, subsystem, parameter, typical, unit = "quadratic_drag", "drive", "quadratic_drag", 0.40, "kg/m"

  def load(self, sim: Simulation) -> None:
    v = sim.dynamics.stage.vx[self.columns]
    sim.dynamics.wrench[0, self.columns] -= self.value * 1.5**0.25 * np.sign(v) * np.abs(v) ** 1.75


class DrivelineBacklash(Effect):
  """Worn gears: the axles turn freely within their play; parameter: the whole of it, at the motor."""

  id, subsystem, parameter, typical, unit = "driveline_backlash", "drive", "driveline_play", 1.0, "rad"

  def prepare(self, car: SimpleNamespace) -> None:
    car.shaft_play[self.columns] += 0.5 * self.value * car.gear_ratio[self.columns]


class CgLateralOffset(Effect):
  """The battery sits to one side: wheel loads and lever arms differ; marker and IMU stay on the centre line."""

  id, subsystem, parameter, typical, unit, signed = "cg_lateral_offset", "body", "cg_lateral_offset", 0.014, "m", True

  def prepare(self, car: SimpleNamespace) -> None:
    for name, sign in (("cg_lateral", 1), ("imu_y", -1), ("marker_y", -1)):
      getattr(car, name)[self.columns] += sign * self.value


class Payload(Effect):
  """A box on the deck, ahead of or behind the centre of gravity; pose marker and IMU stay on the chassis."""

  id, subsystem, parameter, typical, unit = "payload", "body", "payload_mass", 0.55, "kg"

  def choose(self, rng: np.random.Generator) -> None:
    self.ahead = rng.uniform(-0.04, 0.03)

  def prepare(self, car: SimpleNamespace) -> None:
    c = self.columns
    bare = car.mass[c].copy()
    car.mass[c] += self.value
    shift = self.ahead * self.value / car.mass[c]
    car.yaw_inertia[c] += bare * self.value / car.mass[c] * self.ahead**2 + self.value * 0.0008
    for name, sign in (("cg_to_front", -1), ("cg_to_rear", 1), ("imu_x", -1), ("marker_x", -1)):
      getattr(car, name)[c] += sign * shift

  def truth(self) -> dict[str, float]:
    return super().truth() | {"payload_x": float(self.ahead)}
