"""Physical quantities of many simulated cars, written into MuJoCo's per-simulation model fields.

Mechanisms and the twin speak of a cornering stiffness or an added mass; this file alone knows in
which expanded model field of a `mujoco.batch.Batch` that lives. Values are per simulation (row).
"""

import difflib

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.vehicle.ids import Handles
from qcar_twin.vehicle.mjcf import differential_rows, suspension_damping
from qcar_twin.vehicle.tyre import COLUMN
from qcar_twin.vehicle.vehicle import GRAVITY, WHEELS

Array = NDArray[np.float64]
Rows = slice | NDArray[np.int64]
TYRE = tuple(name for name in COLUMN if name not in ("tag", "nominal_load", "carcass_damping"))
DRIVE = ("torque_per_volt", "motor_damping", "driveline_friction", "driveline_damping", "rotor_inertia", "max_torque")
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
OTHER = (
  "gravity_x",
  "gravity_y",
  "differential_damping",
  "differential_friction",
  "servo_time_constant",
  "ackermann_fraction",
  "suspension_frequency",
  "suspension_damping_ratio",
)


class Fields:
  """Quantities of N cars, and the batch they are written to."""

  def __init__(self, batch: Batch, car: CarDimensions, native_tyre: bool):
    self._batch, self._car, self._native = batch, car, native_tyre
    model = batch.model
    self._handles = Handles.of(model)
    self._ackermann = model.equality("ackermann").id
    self._differential_tendons = [t for t in range(model.ntendon) if model.tendon(t).name.endswith("_differential")]
    self._differential = [
      (model.equality(model.tendon(t).name).id, float(model.tendon_invweight0[t])) for t in self._differential_tendons
    ]
    self._imu = model.site("imu").id
    self._imu_x = float(model.site_pos[self._imu, 0])
    self._timestep = float(model.opt.timestep)
    self._rest = _Rest(model, self._handles.chassis)
    self._full_ackermann = car.track_width / (2.0 * car.wheelbase)
    self._springs = _Springs(batch, [model.joint(f"{wheel}_suspension") for wheel in WHEELS])
    self.values: dict[str, Array] = {}

  def load(self, values: dict[str, Array]) -> None:
    """Take base values of every quantity, (N,) or (N, 4), and write all of them."""
    self.values = values
    self.write(set(values), slice(None))

  def write(self, changed: set[str], rows: Rows) -> None:
    """Bring the model fields of some simulations in line with their quantities."""
    for name in changed & set(TYRE):
      self._write_tyre(name, rows)
    if changed & set(DRIVE):
      self._write_drive(rows)
    if changed & set(BODY):
      self._write_body(rows)
    if changed & set(OTHER):
      self._write_other(changed, rows)

  def _write_tyre(self, name: str, rows: Rows) -> None:
    value = self.values[name][rows]
    if not self._native:
      self._scatter("geom_user", COLUMN[name], rows, value)
    elif name == "friction_coefficient":
      self._scatter("geom_friction", 0, rows, value)

  def _scatter(self, field: str, column: int, rows: Rows, value: Array) -> None:
    """Write wheel-wise values, (n, 4), into one column of a geom field."""
    target = self._batch.expand(field)
    for k, geom in enumerate(self._handles.wheels):
      target[rows, geom, column] = value[:, k]

  def _write_drive(self, rows: Rows) -> None:
    """torque = a u - b w with a = K / R, b = K^2 / R: K = b / a, R = b / a^2 (armature circuit without inductance)."""
    a, b = self.values["torque_per_volt"][rows], self.values["motor_damping"][rows]
    gain = self._batch.expand("actuator_gainprm")
    gain[rows, self._handles.motor, 0] = b / a**2
    gain[rows, self._handles.motor, 1] = b / a
    self._batch.expand("dof_frictionloss")[rows, self._handles.motor_dof] = self.values["driveline_friction"][rows]
    self._batch.expand("dof_damping")[rows, self._handles.motor_dof] = self.values["driveline_damping"][rows]
    self._batch.expand("dof_armature")[rows, self._handles.motor_dof] = self.values["rotor_inertia"][rows]
    if "max_torque" in self.values:
      limit = self.values["max_torque"][rows]
      self._batch.expand("actuator_forcerange")[rows, self._handles.motor] = np.stack([-limit, limit], axis=-1)

  def _write_body(self, rows: Rows) -> None:
    v = {name: self.values[name][rows] for name in BODY}
    total = v["mass"] + v["added_mass"]
    base_x, base_y = self._car.cg_to_front - v["cg_to_front"], v["cg_lateral_offset"]
    share = v["added_mass"] / total
    cg = np.stack([base_x + share * (v["added_mass_x"] - base_x), base_y + share * (v["added_mass_y"] - base_y)], -1)
    reduced = v["mass"] * share  # m1 m2 / (m1 + m2)
    apart = (v["added_mass_x"] - base_x) ** 2 + (v["added_mass_y"] - base_y) ** 2
    mass, position, inertia = self._rest.chassis(total, v["yaw_inertia"] + reduced * apart, cg, v["cg_height_offset"])
    self._batch.expand("body_mass")[rows, self._handles.chassis] = mass
    self._batch.expand("body_ipos")[rows, self._handles.chassis] = position
    self._batch.expand("body_inertia")[rows, self._handles.chassis] = inertia
    # the IMU's place is stated from the centre of gravity, wherever along the car that is found to be
    self._batch.expand("site_pos")[rows, self._imu, 0] = self._imu_x + base_x

  def _write_other(self, changed: set[str], rows: Rows) -> None:
    for name, axis in (("gravity_x", 0), ("gravity_y", 1)):
      if name in changed:
        self._batch.expand("opt.gravity")[rows, axis] = self.values[name][rows]
    if "differential_damping" in changed:
      damping = self.values["differential_damping"][rows]
      for equality, weight in self._differential:
        solref, solimp = differential_rows(damping, self._timestep, weight)
        self._batch.expand("eq_solref")[rows, equality] = solref
        self._batch.expand("eq_solimp")[rows, equality] = solimp
        self._batch.bind("eq_active")[rows, equality] = damping > 0.0
    if "differential_friction" in changed:
      for tendon in self._differential_tendons:
        self._batch.expand("tendon_frictionloss")[rows, tendon] = self.values["differential_friction"][rows]
    if "servo_time_constant" in changed:
      self._batch.expand("actuator_dynprm")[rows, self._handles.steering, 0] = self.values["servo_time_constant"][rows]
    if "ackermann_fraction" in changed:
      curve = self._full_ackermann * self.values["ackermann_fraction"][rows]
      self._batch.expand("eq_data")[rows, self._ackermann, 2] = curve
    if changed & {"suspension_frequency", "suspension_damping_ratio"}:
      frequency, ratio = self.values["suspension_frequency"][rows], self.values["suspension_damping_ratio"][rows]
      self._springs.write(rows, frequency, ratio)


class _Springs:
  """Suspension of the four wheels, at the static load the car was built for."""

  def __init__(self, batch: Batch, joints: list):
    model = batch.model
    self._batch = batch
    self._places = [(j.id, int(j.qposadr[0]), int(j.dofadr[0])) for j in joints]
    self._load = [-model.jnt_stiffness[joint] * model.qpos_spring[place] for joint, place, _ in self._places]
    self._sprung = float(np.sum(self._load)) / GRAVITY
    self._wheel_mass = float(model.body_mass[model.jnt_bodyid[self._places[0][0]]])

  def write(self, rows: Rows, frequency: Array, damping_ratio: Array) -> None:
    """Of the bounce, Hz and -, (n,)."""
    stiffness = self._sprung / 4.0 * (2.0 * np.pi * frequency) ** 2
    damping = suspension_damping(stiffness, self._sprung, damping_ratio, self._wheel_mass)
    for (joint, place, dof), load in zip(self._places, self._load, strict=True):
      self._batch.expand("jnt_stiffness")[rows, joint] = stiffness
      self._batch.expand("qpos_spring")[rows, place] = -load / stiffness
      self._batch.expand("dof_damping")[rows, dof] = damping


class _Rest:
  """What of the car's mass is not in the chassis body: wheels, carriers, motor."""

  def __init__(self, model: mujoco.MjModel, chassis: int):
    inside = [b for b in range(model.nbody) if model.body_parentid[b] == chassis]
    self._mass = model.body_mass[inside].copy()
    self._position = model.body_pos[inside].copy()
    self._inertia = model.body_inertia[inside, 2].copy()
    self._own = model.body_inertia[chassis].copy()
    self._own_mass = float(model.body_mass[chassis])
    self._height = float(model.body_ipos[chassis, 2])

  def chassis(self, total: Array, yaw_inertia: Array, cg: Array, height_offset: Array) -> tuple[Array, Array, Array]:
    """Mass, position and principal inertias of the chassis body for wanted totals about the total CG.

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
    inertia[:, 2] = np.maximum(yaw_inertia - rest - mass * np.sum((xy - cg) ** 2, axis=-1), 1e-5)
    # a rigid body's principal inertias satisfy the triangle inequality
    inertia[:, 1] = np.maximum(inertia[:, 1], inertia[:, 2] - 0.95 * inertia[:, 0])
    inertia[:, 0] = np.maximum(inertia[:, 0], np.abs(inertia[:, 2] - inertia[:, 1]) * 1.01)
    return mass, position, inertia


class FieldsView:
  """`Model` of qcar_twin.twin.mechanisms.base: the quantities of some rows, open to one mechanism."""

  def __init__(self, fields: Fields, rows: Rows):
    self._fields, self._rows = fields, rows
    self.changed: set[str] = set()

  def get(self, quantity: str) -> Array:
    return self._column(quantity)[self._rows].copy()

  def set(self, quantity: str, value: Array) -> None:
    self._column(quantity)[self._rows] = value
    self.changed.add(quantity)

  def _column(self, quantity: str) -> Array:
    if quantity not in self._fields.values:
      near = difflib.get_close_matches(quantity, self._fields.values, n=3) or sorted(self._fields.values)
      raise KeyError(f"no quantity '{quantity}' in the simulator; did you mean {', '.join(near)}?")
    return self._fields.values[quantity]


class Recorder(FieldsView):
  """A view that remembers the fitted value of whatever is changed first."""

  def __init__(self, fields: Fields, rows: Rows, untouched: dict[str, Array]):
    super().__init__(fields, rows)
    self._before = untouched

  def set(self, quantity: str, value: Array) -> None:
    if quantity not in self._before:
      self._before[quantity] = self._column(quantity).copy()
    super().set(quantity, value)
