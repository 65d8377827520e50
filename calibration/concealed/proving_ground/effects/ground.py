"""Effects of tyres and floor."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from ..car import GRAVITY
from ..simulation import Simulation
from .base import Effect


class TyreRelaxation(Effect):
  """Softer carcasses in front: they have to be wound up over a longer way before the full force is there."""

  id, subsystem, parameter, typical, unit = "tyre_relaxation", "tyre", "tyre_relaxation", 0.07, "m"

  def prepare(self, car: SimpleNamespace) -> None:
    car.relaxation_front[self.columns] += self.value


class TyreSaturation(Effect):
  """The force falls short by the share s u^2, u being the use of friction: nothing at small slip, s at the peak."""

  id, subsystem, parameter, typical, unit = "tyre_saturation", "tyre", "tyre_saturation", 0.20, "-"

  def contact(self, sim: Simulation) -> None:
    d, c = sim.dynamics, self.columns
    force = d.force[:, :, c]
    use = (force[0] ** 2 + force[1] ** 2) / (sim.car.friction[c] * d.load[:, c]) ** 2
    force *= 1 - self.value * np.minimum(use, 1.0)


class LongitudinalSlip(Effect):
  """Tread blocks soft along the tyre: the parameter is the extra slip at a drive of 2 m/s^2."""

  id, subsystem, parameter, typical, unit = "longitudinal_slip", "tyre", "longitudinal_slip", 0.04, "-"

  def prepare(self, car: SimpleNamespace) -> None:
    c = self.columns
    softness = 1 / car.slip_stiffness[c] + self.value / (2.0 * car.mass[c] / 4)
    car.slip_stiffness[c] = 1 / softness


class WheelRadiusError(Effect):
  """The wheels are larger than the ruler said."""

  id, subsystem, parameter, typical, unit = "wheel_radius_error", "tyre", "wheel_radius_error", 0.04, "-"
  signed = True

  def prepare(self, car: SimpleNamespace) -> None:
    car.wheel_radius[self.columns] *= 1 + self.value


class LoadTransfer(Effect):
  """A higher centre of gravity and tyres that lose more stiffness and friction with load."""

  id, subsystem, parameter, typical, unit = "load_transfer", "tyre", "load_transfer", 0.025, "m"

  def prepare(self, car: SimpleNamespace) -> None:
    c = self.columns
    car.cg_height[c] += self.value
    car.load_curve[c] += 0.35 * self.size
    car.friction_load[c] += 0.15 * self.size


class CombinedSlip(Effect):
  """Side force lost to drive: F_y / (1 + e (u / u_2)^1.5), u = abs(F_x) / (mu F_z), u_2 at 2 m/s^2."""

  id, subsystem, parameter, typical, unit = "combined_slip", "tyre", "combined_slip", 0.20, "-"

  def contact(self, sim: Simulation) -> None:
    d, c = sim.dynamics, self.columns
    use = np.abs(d.force[0, :, c]) / d.load[:, c] * (GRAVITY / 2.0)
    d.force[1, :, c] /= 1 + self.value * use * np.sqrt(use)


class FrictionChange(Effect):
  """The floor is swept or dusted half-way through the session, over a minute of session time."""

  id, subsystem, parameter, typical, unit, signed = "friction_change", "tyre", "friction_change", -0.25, "-", True

  def act(self, sim: Simulation) -> None:
    c = self.columns
    late = (sim.carried.elapsed[c] + sim.time - 0.5 * sim.carried.session_length[c]) / 15.0
    sim.dynamics.grip[:, c] *= 1 + self.value * 0.5 * (1 + np.tanh(late))


class FrictionPatch(Effect):
  """A slippery place with soft edges: each wheel has its own friction there."""

  id, subsystem, parameter, typical, unit = "friction_patch", "tyre", "friction_patch", 0.40, "-"

  def choose(self, rng: np.random.Generator) -> None:
    self.centre, self.radius = rng.uniform(-0.8, 0.8, 2) + np.array([0.0, 0.8]), rng.uniform(0.7, 1.1)

  def act(self, sim: Simulation) -> None:
    d, s, c = sim.dynamics, sim.dynamics.state, self.columns
    cos, sin = np.cos(s.yaw[c]), np.sin(s.yaw[c])
    off_x = s.x[c] + cos * d.wheel_x[:, c] - sin * d.wheel_y[:, c] - self.centre[0]
    off_y = s.y[c] + sin * d.wheel_x[:, c] + cos * d.wheel_y[:, c] - self.centre[1]
    inside = np.exp(-(((off_x**2 + off_y**2) / self.radius**2) ** 2))
    d.grip[:, c] *= 1 - self.value * inside

  def truth(self) -> dict[str, float]:
    return super().truth() | {
      "friction_patch_x": float(self.centre[0]),
      "friction_patch_y": float(self.centre[1]),
      "friction_patch_radius": float(self.radius),
    }


class SideForce(Effect):
  """Conical tyres push to one side while they roll, split between the axles at random."""

  id, subsystem, parameter, typical, unit, signed = "side_force", "tyre", "side_force", 0.7, "N", True

  def choose(self, rng: np.random.Generator) -> None:
    self.ahead = rng.uniform(-0.03, 0.03)

  def load(self, sim: Simulation) -> None:
    spin = sim.dynamics.stage.motor[self.columns]
    push = self.value * np.tanh(np.abs(spin) / 20.0)
    sim.dynamics.wrench[1, self.columns] += push
    sim.dynamics.wrench[2, self.columns] += self.ahead * push

  def truth(self) -> dict[str, float]:
    return super().truth() | {"side_force_x": float(self.ahead)}


class FloorSlope(Effect):
  """The floor leans to one side of the room: gravity acts along it, and the accelerometer feels what holds the car."""

  id, subsystem, parameter, typical, unit = "floor_slope", "ground", "floor_slope", 0.20, "m/s^2"

  def choose(self, rng: np.random.Generator) -> None:
    angle = rng.uniform(-np.pi, np.pi)
    self.pull = self.value * np.array([np.cos(angle), np.sin(angle)])

  def begin(self, sim: Simulation) -> None:
    sim.dynamics.gravity[:, self.columns] += self.pull[:, None]

  def truth(self) -> dict[str, float]:
    return {"floor_slope_x": float(self.pull[0]), "floor_slope_y": float(self.pull[1])}
