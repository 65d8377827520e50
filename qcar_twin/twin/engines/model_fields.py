"""Physical quantities of many simulated cars, written into MuJoCo's per-simulation model fields.

Mechanisms and the twin speak of a cornering stiffness or an added mass; this file alone knows in
which expanded model field of a `mujoco.batch.Batch` that lives. Values are per simulation (row).
"""

import numpy as np
from mujoco.batch import Batch

from qcar_twin.twin.engines import Array, Rows, controller
from qcar_twin.twin.engines.chassis import BODY, Chassis, Springs
from qcar_twin.twin.engines.servo import most_moved, transition
from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.vehicle.ids import Handles
from qcar_twin.vehicle.mjcf import CENTRE_SWITCH, centre_damping, differential_rows
from qcar_twin.vehicle.similarity import Similarity
from qcar_twin.vehicle.tyre import COLUMN

TYRE = tuple(name for name in COLUMN if name not in ("tag", "nominal_load", "carcass_damping"))
DRIVE = ("torque_per_volt", "motor_damping", "driveline_friction", "driveline_damping", "rotor_inertia", "max_torque",
         "supply_sag")  # fmt: skip
WHEEL_SPIN = "wheel_inertia"
OTHER = (
  "gravity_x",
  "gravity_y",
  "differential_damping",
  "differential_friction",
  "servo_time_constant",
  "servo_inertia",
  "servo_rate",
  "steering_hold",
  "drive_hold",
  *controller.QUANTITIES,
  "braked_at_first",
  "ackermann_fraction",
  "centre_differential",
  "suspension_frequency",
  "suspension_damping_ratio",
)
_LED_BY = {"servo_time_constant", "servo_inertia", "servo_rate", "steering_hold", "drive_hold", *controller.QUANTITIES}
_AT_ONCE = 1e-9  # s, time constant of a filter that passes on what it is told


class Fields:
  """Quantities of N cars, and the batch they are written to.

  Attributes:
    servo: how the servos go on in a step, (4, N), see qcar_twin/twin/engines/servo.py.
    servo_most: what they move in a step at most, and the limit of their rates times lags, rad, (2, N).
    switched: which motors have a speed controller, (N,).
    led: which of them must be led from step to step, (N,); what a car does is the same whoever is beside it.
  """

  def __init__(self, batch: Batch, car: CarDimensions, native_tyre: bool):
    self._batch, self.native = batch, native_tyre
    model = batch.model
    self._handles = Handles.of(model)
    self._wheel_bodies = np.array([model.geom_bodyid[g] for g in self._handles.wheels])
    self._ackermann = model.equality("ackermann").id
    self._differential_tendons = [t for t in range(model.ntendon) if model.tendon(t).name.endswith("_differential")]
    self._differential = [(model.equality(model.tendon(t).name).id, t) for t in self._differential_tendons]
    self._wheel_inertia = float(model.body_inertia[self._wheel_bodies[0], 1])  # which the model's own weights go by
    self._imu = model.site("imu").id
    self._imu_x = float(model.site_pos[self._imu, 0])
    self._timestep = float(model.opt.timestep)
    self._chassis, self._springs = Chassis(model, self._handles.chassis, car), Springs(model, car)
    self._similarity = Similarity.of(car.wheelbase)
    self._full_ackermann = car.track_width / (2.0 * car.wheelbase)
    self.values: dict[str, Array] = {}
    self._sags = False
    self.servo, self.servo_most, self.led = np.zeros((4, 0)), np.zeros((2, 0)), np.zeros(0, dtype=bool)
    self.switched = np.zeros(0, dtype=bool)

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
    if WHEEL_SPIN in changed:
      self._batch.expand("body_inertia")[rows, self._wheel_bodies, 1] = self.values[WHEEL_SPIN][rows][:, None]
    if changed & set(BODY):
      self._write_body(rows)
    if changed & {*OTHER, WHEEL_SPIN}:
      self._write_other(changed, rows)

  def _write_tyre(self, name: str, rows: Rows) -> None:
    value = self.values[name][rows]
    if not self.native:
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
    self._sags = bool(self.values["supply_sag"].any())
    self._batch.expand("dof_frictionloss")[rows, self._handles.motor_dof] = self.values["driveline_friction"][rows]
    self._batch.expand("dof_damping")[rows, self._handles.motor_dof] = self.values["driveline_damping"][rows]
    self._batch.expand("dof_armature")[rows, self._handles.motor_dof] = self.values["rotor_inertia"][rows]
    if "max_torque" in self.values:
      limit = self.values["max_torque"][rows]
      self._batch.expand("actuator_forcerange")[rows, self._handles.motor] = np.stack([-limit, limit], axis=-1)

  def drive(self, command: Array) -> None:
    """Let the supply's resistance act at these drive commands, (N,), until the next.

    The supply's current is the duty times the motor's, so that the motor sees u^2 / U^2 of its resistance.
    """
    if self._sags:
      a, b, sag = (self.values[name] for name in ("torque_per_volt", "motor_damping", "supply_sag"))
      self._batch.expand("actuator_gainprm")[:, self._handles.motor, 0] = b / a**2 * (1.0 + sag * command**2)

  def _write_body(self, rows: Rows) -> None:
    mass, position, inertia, ahead = self._chassis.of({name: self.values[name][rows] for name in BODY})
    self._batch.expand("body_mass")[rows, self._handles.chassis] = mass
    self._batch.expand("body_ipos")[rows, self._handles.chassis] = position
    self._batch.expand("body_inertia")[rows, self._handles.chassis] = inertia
    # the IMU's place is stated from the centre of gravity, wherever along the car that is found to be
    self._batch.expand("site_pos")[rows, self._imu, 0] = self._imu_x + ahead

  def _write_other(self, changed: set[str], rows: Rows) -> None:
    for name, axis in (("gravity_x", 0), ("gravity_y", 1)):
      if name in changed:
        self._batch.expand("opt.gravity")[rows, axis] = self.values[name][rows]
    if changed & {"differential_damping", WHEEL_SPIN}:
      damping = self.values["differential_damping"][rows]
      for equality, tendon in self._differential:
        self._write_damper(equality, tendon, damping, rows)
        self._batch.bind("eq_active")[rows, equality] = damping > 0.0
    if "centre_differential" in self.values and changed & {"centre_differential", WHEEL_SPIN}:
      self._write_centre(rows)
    if "differential_friction" in changed:
      for tendon in self._differential_tendons:
        self._batch.expand("tendon_frictionloss")[rows, tendon] = self.values["differential_friction"][rows]
    if changed & _LED_BY:
      self._write_servo()
    if "ackermann_fraction" in changed:
      curve = self._full_ackermann * self.values["ackermann_fraction"][rows]
      self._batch.expand("eq_data")[rows, self._ackermann, 2] = curve
    if changed & {"suspension_frequency", "suspension_damping_ratio"}:
      frequency, ratio = self.values["suspension_frequency"][rows], self.values["suspension_damping_ratio"][rows]
      stiffness, damping = self._springs.of(frequency, ratio)
      for joint, load in zip(self._springs.joints, self._springs.load, strict=True):
        model = self._batch.model
        self._batch.expand("jnt_stiffness")[rows, joint] = stiffness
        self._batch.expand("qpos_spring")[rows, model.jnt_qposadr[joint]] = -load / stiffness
        self._batch.expand("dof_damping")[rows, model.jnt_dofadr[joint]] = damping

  def _write_servo(self) -> None:
    """MuJoCo's filter is a servo of first order. One of second order, of limited rate or told within a period is led
    from step to step, and the filter passes on what it is told; so is a motor with a speed controller, or told within
    a period."""
    lag, rate = self.values["servo_time_constant"], self.values["servo_rate"]
    self.servo = transition(lag, self.values["servo_inertia"], self._timestep)
    self.servo_most = most_moved(rate, lag, self._timestep)
    self.led = (self.values["servo_inertia"] > 0.0) | np.isfinite(rate)
    self.switched = controller.present(self.values)
    self.led |= (self.values["steering_hold"] > 0.0) | (self.values["drive_hold"] > 0.0) | self.switched
    self._batch.expand("actuator_dynprm")[:, self._handles.steering, 0] = np.where(self.led, _AT_ONCE, lag)

  def _write_damper(self, equality: int, tendon: int, damping: Array, rows: Rows) -> None:
    """A damper's numbers count in weights of its tendon, which go by the inertia of the wheels that it couples."""
    weight = float(self._batch.model.tendon_invweight0[tendon]) * self._wheel_inertia / self.values[WHEEL_SPIN][rows]
    solref, solimp = differential_rows(damping, self._timestep, weight)
    self._batch.expand("eq_solref")[rows, equality] = solref
    self._batch.expand("eq_solimp")[rows, equality] = solimp

  def _write_centre(self, rows: Rows) -> None:
    freedom, model = self.values["centre_differential"][rows], self._batch.model
    damping = centre_damping(freedom, self._similarity)
    self._write_damper(model.equality("centre").id, model.tendon("centre").id, damping, rows)
    for name, active in CENTRE_SWITCH.items():
      self._batch.bind("eq_active")[rows, model.equality(name).id] = (freedom > 0.0) == active
