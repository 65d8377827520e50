"""Body and springs of a car from the quantities a twin speaks of, the same for every engine."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.vehicle.mjcf import suspension_damping
from qcar_twin.vehicle.similarity import Similarity
from qcar_twin.vehicle.vehicle import GRAVITY, WHEELS

Array = NDArray[np.float64]
_LEAST_INERTIA = 1e-5  # kg m^2, of the chassis alone in yaw, of the QCar's class
BODY = (
  "mass",
  "yaw_inertia",
  "cg_to_front",
  "added_mass",
  "added_mass_x",
  "added_mass_y",
  "cg_height_offset",
  "cg_lateral_offset",
)


class Chassis:
  """The chassis body that makes the whole car have a wanted mass, centre of gravity and yaw inertia.

  Args:
    model: of the nominal car.  body: id of its chassis.  car: its measured numbers.
  """

  def __init__(self, model: mujoco.MjModel, body: int, car: CarDimensions):
    inside = [b for b in range(model.nbody) if model.body_parentid[b] == body]
    self._car = car
    self._mass = model.body_mass[inside].copy()
    self._position = model.body_pos[inside].copy()
    self._inertia = model.body_inertia[inside, 2].copy()
    self._own = model.body_inertia[body].copy()
    self._own_mass = float(model.body_mass[body])
    self._height = float(model.body_ipos[body, 2])
    self._least = _LEAST_INERTIA * Similarity.of(car.wheelbase).mass * Similarity.of(car.wheelbase).length ** 2

  def of(self, v: dict[str, Array]) -> tuple[Array, Array, Array, Array]:
    """Mass [kg], position [m] and principal inertias [kg m^2] of the body, and how far ahead the CG is of the measured.

    Args:
      v: the quantities of BODY, (n,).
    """
    total = v["mass"] + v["added_mass"]
    base_x, base_y = self._car.cg_to_front - v["cg_to_front"], v["cg_lateral_offset"]
    share = v["added_mass"] / total
    cg = np.stack([base_x + share * (v["added_mass_x"] - base_x), base_y + share * (v["added_mass_y"] - base_y)], -1)
    reduced = v["mass"] * share  # m1 m2 / (m1 + m2)
    apart = (v["added_mass_x"] - base_x) ** 2 + (v["added_mass_y"] - base_y) ** 2
    return *self._body(total, v["yaw_inertia"] + reduced * apart, cg, v["cg_height_offset"]), base_x

  def _body(self, total: Array, yaw_inertia: Array, cg: Array, height_offset: Array) -> tuple[Array, Array, Array]:
    """For wanted totals about the total CG.

    Args:
      total: mass of the whole car, kg, (n,).  yaw_inertia: about its CG, kg m^2, (n,).
      cg: position of the CG in the chassis frame, m, (n, 2).  height_offset: CG above nominal, m, (n,).
    """
    mass = total - self._mass.sum()
    xy = (total[:, None] * cg - self._mass @ self._position[:, :2]) / mass[:, None]
    position = np.column_stack([xy, self._height + height_offset * total / mass])
    away = np.sum((self._position[None, :, :2] - cg[:, None]) ** 2, axis=-1)
    rest = self._inertia.sum() + away @ self._mass
    inertia = np.tile(self._own, (len(total), 1)) * (mass / self._own_mass)[:, None]
    inertia[:, 2] = np.maximum(yaw_inertia - rest - mass * np.sum((xy - cg) ** 2, axis=-1), self._least)
    # a rigid body's principal inertias satisfy the triangle inequality
    inertia[:, 1] = np.maximum(inertia[:, 1], inertia[:, 2] - 0.95 * inertia[:, 0])
    inertia[:, 0] = np.maximum(inertia[:, 0], np.abs(inertia[:, 2] - inertia[:, 1]) * 1.01)
    return mass, position, inertia


class Springs:
  """Suspension of the four wheels, at the static load the car was built for.

  Attributes:
    joints: their ids, in the order of WHEELS.  load: what they carry at rest, N, (4,).
  """

  def __init__(self, model: mujoco.MjModel, car: CarDimensions):
    self._step = Similarity.of(car.wheelbase).longest_step
    self.joints = [model.joint(f"{wheel}_suspension").id for wheel in WHEELS]
    self.load = [-model.jnt_stiffness[j] * model.qpos_spring[int(model.jnt_qposadr[j])] for j in self.joints]
    self._sprung = float(np.sum(self.load)) / GRAVITY
    self._wheel_mass = float(model.body_mass[model.jnt_bodyid[self.joints[0]]])

  def of(self, frequency: Array, damping_ratio: Array) -> tuple[Array, Array]:
    """Stiffness [N/m] and damping [N s/m] of one wheel's spring from those of the bounce, Hz and -, (n,)."""
    stiffness = self._sprung / 4.0 * (2.0 * np.pi * frequency) ** 2
    return stiffness, suspension_damping(stiffness, self._sprung, damping_ratio, self._wheel_mass, self._step)
