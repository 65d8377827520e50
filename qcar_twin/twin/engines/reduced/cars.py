"""Cars on the reduced car, behind the same interface as MuJoCo's."""

import concurrent.futures
import functools
import os
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from qcar_twin.plant import START
from qcar_twin.twin.engines import Array, ByMotion, Rows, controller
from qcar_twin.twin.engines.chassis import BODY, Chassis, Springs
from qcar_twin.twin.engines.reduced import layout
from qcar_twin.twin.engines.reduced.build import load
from qcar_twin.twin.engines.servo import most_moved, transition
from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.vehicle.drive import largest_command
from qcar_twin.vehicle.ids import Handles
from qcar_twin.vehicle.mjcf import centre_damping, contact_row, sinking, wheel_half_width
from qcar_twin.vehicle.tyre.laws import DEFAULT
from qcar_twin.vehicle.vehicle import GRAVITY, TyreKind, Vehicle

_WORTH_A_THREAD = 64  # blocks of cars in a period below which a second thread costs more than it brings
_PIECES = 8  # of a run per thread: blocks end at different times
_WHEEL = {name.lower(): row for name, row in layout.NUMBER_ROW.items() if name in layout.WHEEL_NUMBERS}
_PLAIN = {
  "torque_per_volt": "TORQUE_PER_COMMAND",
  "max_torque": "MAX_TORQUE",
  "supply_sag": "SUPPLY_SAG",
  "steering_hold": "STEERING_HOLD",
  "drive_hold": "DRIVE_HOLD",
  "braked_at_first": "BRAKED_AT_FIRST",
  **{name: name.upper() for name in controller.QUANTITIES},
  "motor_damping": "MOTOR_DAMPING",
  "driveline_friction": "DRIVELINE_FRICTION",
  "wheel_inertia": "WHEEL_INERTIA",
  "driveline_damping": "DRIVELINE_DAMPING",
  "differential_damping": "DIFFERENTIAL_DAMPING",
  "differential_friction": "DIFFERENTIAL_FRICTION",
  "gravity_x": "GRAVITY_X",
  "gravity_y": "GRAVITY_Y",
}


def irreducible(vehicle: Vehicle, tyre: TyreKind) -> str:
  """What the reduced car lacks that a car has; "" if nothing."""
  lacking = {
    "MuJoCo's own friction": tyre != "contact",
    f"the tyre law '{vehicle.tyre_law}'": vehicle.tyre_law != DEFAULT,
    "rolling resistance in the wheels": vehicle.rolling_resistance != 0.0,
  }
  return "it lacks " + " and ".join(what for what, lacks in lacking.items() if lacks) if any(lacking.values()) else ""


class Numbers:
  """Quantities of cars as rows of reduced_car.c's numbers.

  Args:
    model: of the nominal car in MuJoCo, which masses and springs are read from.
    vehicle, car: its numbers.  step: of the simulation, s.
  """

  def __init__(self, model: mujoco.MjModel, vehicle: Vehicle, car: CarDimensions, step: float):
    self._vehicle, self._car, self._step = vehicle, car, step
    self._chassis, self.springs = Chassis(model, Handles.of(model).chassis, car), Springs(model, car)
    self._motor_mass = float(model.body("motor").mass[0])

  def write(self, value: dict[str, Array], changed: set[str], out: Array) -> None:
    """Bring numbers (N_NUMBER, n) in line with what has changed among the quantities."""
    row = layout.NUMBER_ROW
    for name, first in _WHEEL.items():
      if name in changed:
        out[first : first + 4] = value[name].T
    for name, number in _PLAIN.items():
      if name in changed:
        out[row[number]] = value[name]
    if changed & {"servo_time_constant", "servo_inertia", "servo_rate"}:
      servo = transition(value["servo_time_constant"], value["servo_inertia"], self._step)
      most = most_moved(value["servo_rate"], value["servo_time_constant"], self._step)
      out[row["SERVO_A"] : row["SERVO_MOST"] + 1] = np.concatenate([servo, most])
    if "ackermann_fraction" in changed:
      out[row["ACKERMANN"]] = self._car.track_width / (2.0 * self._car.wheelbase) * value["ackermann_fraction"]
    if "centre_differential" in changed:
      out[row["CENTRE_DAMPING"]] = centre_damping(value["centre_differential"], self._vehicle.similarity)
    if changed & {"rotor_inertia", "wheel_inertia"}:
      wheels = 4.0 * value["wheel_inertia"] * self._car.gear_ratio**2
      out[row["SPINNING_INERTIA"]] = value["rotor_inertia"] + wheels
    if changed & {"suspension_frequency", "suspension_damping_ratio"}:
      stiffness, damping = self.springs.of(value["suspension_frequency"], value["suspension_damping_ratio"])
      out[row["SPRING"]], out[row["DAMPER"]] = stiffness, damping
    if changed & {*BODY, "wheel_inertia"}:
      for name, number in self._body({name: value[name] for name in BODY}, value["wheel_inertia"]).items():
        out[row[name]] = number

  def _body(self, value: dict[str, Array], about_axle: Array) -> dict[str, Array]:
    """Moments of mass about the chassis frame: of the sprung body with the motor, and of the four wheels."""
    v, wheel = self._vehicle, self._vehicle.wheel_mass
    body, place, inertia, ahead = self._chassis.of(value)
    sprung, (x, y, z), (wx, wy, wz) = body + self._motor_mass, place.T, v.wheel_positions.T
    about_x, _, about_z = (4.0 * i for i in v.wheel_inertias)
    return {
      "MASS": sprung + 4.0 * wheel,
      "MOMENT_X": sprung * x + wheel * wx.sum(),
      "MOMENT_Y": sprung * y + wheel * wy.sum(),
      "MOMENT_Z": sprung * z + wheel * wz.sum(),
      "YAW_INERTIA": sprung * (x**2 + y**2) + inertia[:, 2] + wheel * (wx**2 + wy**2).sum() + about_z,
      "ROLL_INERTIA": sprung * z**2 + inertia[:, 0] + wheel * (wz**2).sum() + about_x,
      "PITCH_INERTIA": sprung * z**2 + inertia[:, 1] + wheel * (wz**2).sum() + 4.0 * about_axle,
      "YAW_ROLL_INERTIA": -(sprung * x * z + wheel * (wx * wz).sum()),
      "YAW_PITCH_INERTIA": -(sprung * y * z + wheel * (wy * wz).sum()),
      "SPRUNG_MASS": sprung, "SPRUNG_X": x, "SPRUNG_Y": y, "SPRUNG_Z": z, "CG_SHIFT": ahead,
    }  # fmt: skip


class ReducedCars:
  """N cars; see `Engine`.

  Args:
    numbers: how quantities become a car's numbers; constants: what all cars share.
    car: measured numbers.  sinking: of the wheels at rest, m.
    substeps: simulation steps per control period.
    size: N.  threads: 0 for all cores; results do not depend on it.

  Attributes:
    constants, numbers, state: the arrays that the C code reads and writes, rows as in `layout`; numbers and state
      have a column for each car, filled up to a whole number of lanes.
  """

  def __init__(
    self, numbers: Numbers, constants: Array, car: CarDimensions, sinking: float, substeps: int, size: int, threads: int
  ):
    self._writer, self.constants, self._car, self._sinking = numbers, constants, car, sinking
    self._size, self._substeps, self._threads = size, substeps, threads or os.cpu_count() or 1
    self._lanes = load().lanes()
    self._stride = -(-size // self._lanes) * self._lanes
    self.state = np.zeros((layout.N_STATE, self._stride))
    self.numbers = np.ones((layout.N_NUMBER, self._stride))
    self._bind()
    self._force: Array | None = None
    self._running: NDArray[np.intp] | None = None
    self._blocks, self._still = self._moving(None)
    self.values: dict[str, Array] = {}

  def _bind(self) -> None:
    """The compiled car, and where this one's arrays lie."""
    self._library = load()
    self._pointers = tuple(a.ctypes.data for a in (self.constants, self.numbers, self.state))

  def __getstate__(self) -> dict[str, Any]:
    """Cars as they are, for a copy or another process."""
    return {name: value for name, value in vars(self).items() if name not in ("_library", "_pointers")}

  def __setstate__(self, state: dict[str, Any]) -> None:
    vars(self).update(state)
    self._bind()

  def load(self, values: dict[str, Array]) -> None:
    self.values = values
    self.numbers[layout.NUMBER_ROW["MAX_TORQUE"]] = np.inf
    self.numbers[layout.NUMBER_ROW["CENTRE_DAMPING"]] = 0.0
    self.write(set(values), slice(None))

  def write(self, changed: set[str], rows: Rows) -> None:
    """Of all cars, whichever rows were changed: a column costs next to nothing."""
    self._writer.write(self.values, changed, self.numbers[:, : self._size])
    self.numbers[:, self._size :] = self.numbers[:, self._size - 1 : self._size]

  def commit(self) -> None:
    pass

  def place(self, start: Array, turning: Array, signals: Array) -> None:
    s, n, (left, right, rear_left, rear_right, motor) = dict(zip(START, start.T, strict=True)), self._size, turning.T
    cosine, sine = np.cos(s["pose_yaw"]), np.sin(s["pose_yaw"])
    placed = {
      "X": s["pose_x"], "Y": s["pose_y"], "YAW": s["pose_yaw"], "COSINE": cosine, "SINE": sine,
      "VELOCITY_X": cosine * s["velocity_x"] - sine * s["velocity_y"],
      "VELOCITY_Y": sine * s["velocity_x"] + cosine * s["velocity_y"],
      "YAW_RATE": s["yaw_rate"], "MOTOR": motor, "FRONT_DIFFERENCE": left - right,
      "REAR_DIFFERENCE": rear_left - rear_right, "CENTRE_DIFFERENCE": 0.5 * (left + right - rear_left - rear_right),
      "SERVO": s["steering_angle"], "SERVO_BEFORE": s["steering_angle"],
      "TOLD": s["steering_angle"], "TOLD_BEFORE": s["steering_angle"],
    }  # fmt: skip
    self.state[:] = 0.0
    for name, value in placed.items():
      self.state[layout.STATE_ROW[name], :n] = value
    self.state[layout.STATE_ROW["LOAD"] :][:4] = -1.0
    self.state[layout.STATE_ROW["DRIVEN"] :][:3] = np.nan  # and what the brake does
    self.state[layout.STATE_ROW["HEIGHT"] :][:4] = -self._sinking
    self.state[:, n:] = self.state[:, n - 1 : n]
    signals[:, :6], signals[:, 6:8], signals[:, 8], signals[:, 9] = start[:, :6], 0.0, motor, s["steering_angle"]

  def adopt(self, row: int, other: "ReducedCars") -> None:
    self.state[:, row] = other.state[:, 0]

  def push(self, force: Array, signals: Array) -> None:
    self._force = np.ascontiguousarray(force)

  def hold(self, rows: Rows, drive: Array) -> None:
    for name, told in zip(("DRIVEN", "DRIVEN_BEFORE"), drive.T, strict=True):
      self.state[layout.STATE_ROW[name], : self._size][rows] = told

  def advance(self, commands: Array, running: NDArray[np.intp] | None, signals: Array) -> None:
    commands = np.ascontiguousarray(commands)
    if running is not self._running:
      self._running, self._blocks, self._still = running, *self._moving(running)
    blocks, still = self._blocks, self._still
    before = (self.state[:, still], signals[still]) if len(still) else None
    self._spread(
      lambda first, count: self._library.advance(
        *self._pointers, self._stride, self._size, commands.ctypes.data,
        None if self._force is None else self._force.ctypes.data, signals.ctypes.data, self._substeps,
        blocks[first:].ctypes.data, count,
      ),
      len(blocks),
      self._threads if len(blocks) >= _WORTH_A_THREAD else 1,
    )  # fmt: skip
    if before:
      self.state[:, still], signals[still] = before

  def run(self, commands: Array, periods: NDArray[np.int64], signals: Array, by_motion: ByMotion) -> bool:
    commands, periods = np.ascontiguousarray(commands), np.ascontiguousarray(periods, dtype=np.int64)
    drag, weakened = by_motion.drag, by_motion.weakened
    self._spread(
      lambda first, count: self._library.drive(
        *self._pointers, self._stride, self._size, commands.ctypes.data, len(commands), periods.ctypes.data,
        drag.ctypes.data, None if weakened is None else weakened.ctypes.data, signals.ctypes.data, self._substeps,
        first, count,
      ),
      self._stride // self._lanes,
      self._threads,
      _PIECES,
    )  # fmt: skip
    return True

  def _moving(self, running: NDArray[np.intp] | None) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Blocks of a register's cars with one in them that runs, and the cars in those blocks that stay as they are."""
    if running is None or len(running) == self._size:
      return np.arange(self._stride // self._lanes), np.empty(0, dtype=np.intp)
    blocks = np.unique(running // self._lanes)
    neighbours = (self._lanes * blocks[:, None] + np.arange(self._lanes)).ravel()
    return blocks, np.setdiff1d(neighbours[neighbours < self._size], running)

  def _spread(self, call: Callable[[int, int], None], blocks: int, threads: int, pieces: int = 1) -> None:
    """The call on all blocks, in parts of (first, count), at once on so many threads."""
    parts = min(blocks, threads * pieces) if threads > 1 else 1
    if parts == 1:
      call(0, blocks)
    else:
      ends = np.linspace(0, blocks, parts + 1).astype(int)
      list(_pool(threads).map(lambda k: call(int(ends[k]), int(ends[k + 1] - ends[k])), range(parts)))


@functools.cache
def _pool(threads: int) -> concurrent.futures.ThreadPoolExecutor:
  return concurrent.futures.ThreadPoolExecutor(threads, "reduced-car")


def constants(vehicle: Vehicle, numbers: Numbers, step: float, nominal: dict[str, Array]) -> Array:
  """What all cars share, in the order of CONSTANTS.

  Args:
    numbers: of this vehicle.  nominal: quantities of one nominal car, (1,) or (1, 4).
  """
  v, sunk, contact, springs = vehicle, sinking(vehicle), contact_row(vehicle), numbers.springs
  own = np.ones((layout.N_NUMBER, 1))
  numbers.write(nominal, set(nominal), own)
  rest = v.cg_height - sunk
  shares = _shares(vehicle)
  middle = rest + sunk / 2.0  # of the patch: MuJoCo's contact point lies halfway into the floor
  value = {
    "STEP": step,
    "GRAVITY": GRAVITY,
    "FRONT_LOAD": v.static_load[0],
    "REAR_LOAD": v.static_load[1],
    "FRONT_PRELOAD": springs.load[0],
    "REAR_PRELOAD": springs.load[2],
    "CARCASS_DAMPING": v.carcass_damping,
    "FRONT_X": v.cg_to_front,
    "REAR_X": -v.cg_to_rear,
    "HALF_TRACK": v.track_width / 2.0,
    "ORIGIN_HEIGHT": middle,
    "ROLLING_RADIUS": v.wheel_radius - sunk / 2.0,
    # an ellipsoid of half width w rolls on w^2 / R of radius when it leans, on R when it turns
    "ROLL_ARM": middle - wheel_half_width(v) ** 2 / v.wheel_radius,
    "PITCH_ARM": middle - v.wheel_radius,
    "FRONT_SHARE": shares[0],
    "REAR_SHARE": shares[1],
    "FRONT_DRIVEN": float("front" in v.driven_axles),
    "REAR_DRIVEN": float("rear" in v.driven_axles),
    "KNUCKLE_INERTIA": 2.0 * v.wheel_inertias[2],
    "WHEEL_MASS": v.wheel_mass,
    "GEAR": v.gear_ratio,
    "IMU_X": v.imu_x,
    "IMU_Y": v.imu_y,
    "MAX_STEERING": v.max_steering,
    "MAX_COMMAND": largest_command(v.drive, v.supply_voltage),
    "DUTY_SUPPLY": (supply := CarDimensions.of(v).duty_supply),
    "NEUTRAL": controller.NEUTRAL * supply,
    "STANDS": controller.STANDS,
    "CORNER": controller.CORNER,
    "SINKING": sunk,
    "CONTACT_DAMPING": contact[0],
    "CONTACT_STIFFNESS": contact[1],
    "CONTACT_SOFTNESS": contact[2],
    "PATCH_MOBILITY": _patch_mobility(v, middle, own[:, 0]),
  }
  return np.array([value[name] for name in layout.CONSTANTS])


def _shares(vehicle: Vehicle) -> tuple[float, float]:
  """By how much of the difference between the axles' mean wheel speeds the front one is faster and the rear one slower
  than the motor at the wheels: the halves of a centre differential, or all of it where an axle is not driven."""
  return {"all-wheel": (0.5, 0.5), "rear": (1.0, 0.0), "front": (0.0, 1.0)}[vehicle.layout]


def _patch_mobility(v: Vehicle, height: float, numbers: Array) -> float:
  """Mean inverse mass of a wheel's patch along the ground, J M^-1 J' over both directions and all wheels, 1/kg.

  Of the system that reduced_car.c solves, without tyres: (vx, vy, yaw, roll, pitch rate, differences, motor, difference
  between the axles), with two driven axles on one shaft.
  """
  n = {name: float(numbers[row]) for name, row in layout.NUMBER_ROW.items()}
  wheels, mx, my, mz = 4.0 * v.wheel_inertia * v.gear_ratio, n["MOMENT_X"], n["MOMENT_Y"], n["MOMENT_Z"]
  ahead, behind = _shares(v)
  apart = 2.0 * v.wheel_inertia * (ahead - behind)
  inertia = np.zeros((9, 9))
  inertia[:5, :5] = [
    [n["MASS"], 0.0, -my, 0.0, mz],
    [0.0, n["MASS"], mx, -mz, 0.0],
    [-my, mx, n["YAW_INERTIA"], n["YAW_ROLL_INERTIA"], n["YAW_PITCH_INERTIA"]],
    [0.0, -mz, n["YAW_ROLL_INERTIA"], n["ROLL_INERTIA"], 0.0],
    [mz, 0.0, n["YAW_PITCH_INERTIA"], 0.0, n["PITCH_INERTIA"]],
  ]
  inertia[5, 5] = inertia[6, 6] = v.wheel_inertia / 2.0
  inertia[7, 7], inertia[4, 7], inertia[7, 4] = n["SPINNING_INERTIA"], wheels, wheels
  inertia[8, 8] = 2.0 * v.wheel_inertia * (ahead**2 + behind**2)
  inertia[4, 8] = inertia[8, 4] = apart
  inertia[7, 8] = inertia[8, 7] = v.gear_ratio * apart
  rows = []
  for k, (x, y, _) in enumerate(v.wheel_positions):
    along = np.array([1.0, 0.0, -y, 0.0, -height, 0.0, 0.0, -v.wheel_radius * v.gear_ratio, 0.0])
    along[8] = v.wheel_radius * (-ahead if k < 2 else behind)
    along[5 + k // 2] = -v.wheel_radius * (0.5 if k % 2 == 0 else -0.5)
    rows += [along, np.array([0.0, 1.0, x, height, 0.0, 0.0, 0.0, 0.0, 0.0])]
  moves = 8 if len(v.driven_axles) == 2 else 9
  rows, inertia = np.stack(rows)[:, :moves], inertia[:moves, :moves]
  return float(np.mean(np.sum(rows * np.linalg.solve(inertia, rows.T).T, axis=1)))
