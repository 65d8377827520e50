"""Cars in MuJoCo, side by side in one `mujoco.batch.Batch`."""

from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from qcar_twin.plant import START
from qcar_twin.twin.engines import Array, ByMotion, Rows, controller
from qcar_twin.twin.engines.model_fields import Fields
from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.vehicle.ids import Handles

_STATE = ("qpos", "qvel", "act", "ctrl", "qacc_warmstart", "plugin_state", "eq_active", "time")
_HELD = ("xfrc_applied",)  # what acts besides until further notice
# qpos of the free joint: position, quaternion; qvel: velocity in the world frame, rate in the body frame
_VX, _VY, _YAW_RATE = 0, 1, 5


class MujocoCars:
  """The engine that the twin's claims are made on; see `Engine`.

  Args:
    batch: what carries the cars; put back to MuJoCo's start.
    car: measured numbers.
    period: control period, s.  substeps: simulation steps in it.
    rest_height: of the chassis frame as the nominal car stands, m.
    native_tyre: MuJoCo's own friction in place of the tyre's law.
  """

  def __init__(
    self, batch: Batch, car: CarDimensions, period: float, substeps: int, rest_height: float, native_tyre: bool
  ):
    self.batch, self._car, self._rest_height = batch, car, rest_height
    self._period, self._substeps = period, substeps
    batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
    self._fields = Fields(batch, car, native_tyre)
    self._qpos, self._qvel, self._ctrl, self._act = batch.qpos, batch.qvel, batch.ctrl, batch.act
    self._xfrc, self._sensordata = batch.bind("xfrc_applied"), batch.bind("sensordata")
    self._handles = Handles.of(batch.model)
    self._servo_rate = np.zeros(len(batch.qpos))  # times the servo's lag, rad
    self._told = np.zeros((2, len(batch.qpos)))  # angles that servos were told in the two periods before, rad
    self._driven = np.full((2, len(batch.qpos)), np.nan)  # drive's commands of these; NaN is what nobody knows
    self._braked = np.full(len(batch.qpos), np.nan)  # what speed controllers' brakes do; NaN at a start
    self._limit = float(batch.model.actuator_ctrlrange[self._handles.steering, 1])

  def __getstate__(self) -> dict[str, Any]:
    """Cars as they are, for a copy or another process: a batch of as many is made there."""
    batch = self.batch
    made = (self._car, self._period, self._substeps, self._rest_height, self._fields.native)
    held = {name: np.array(batch.bind(name)) for name in (*_STATE, *_HELD)}
    return {
      "batch": (batch.model, batch.nsim, batch.nthread), "made": made, "values": self.values, "held": held,
      "yaw": self._yaw.copy(), "servo_rate": self._servo_rate.copy(), "told": self._told.copy(),
      "driven": self._driven.copy(), "braked": self._braked.copy(),
    }  # fmt: skip

  def __setstate__(self, state: dict[str, Any]) -> None:
    self.__init__(Batch(*state["batch"]), *state["made"])
    self.load(state["values"])
    self.commit()
    for name, array in state["held"].items():
      self.batch.bind(name)[:] = array
    for name in ("yaw", "servo_rate", "told", "driven", "braked"):
      setattr(self, f"_{name}", state[name].copy())

  @property
  def values(self) -> dict[str, Array]:
    return self._fields.values

  def load(self, values: dict[str, Array]) -> None:
    self._fields.load(values)

  def write(self, changed: set[str], rows: Rows) -> None:
    self._fields.write(changed, rows)

  def commit(self) -> None:
    self.batch.set_const()

  def place(self, start: Array, turning: Array, signals: Array) -> None:
    s = {name: start[:, i] for i, name in enumerate(START)}
    car = self._car
    self._qpos[:, 0], self._qpos[:, 1], self._qpos[:, 2] = s["pose_x"], s["pose_y"], self._rest_height
    self._qpos[:, 3], self._qpos[:, 6] = np.cos(s["pose_yaw"] / 2), np.sin(s["pose_yaw"] / 2)
    cosine, sine = np.cos(s["pose_yaw"]), np.sin(s["pose_yaw"])
    self._qvel[:, _VX] = cosine * s["velocity_x"] - sine * s["velocity_y"]
    self._qvel[:, _VY] = sine * s["velocity_x"] + cosine * s["velocity_y"]
    self._qvel[:, _YAW_RATE] = s["yaw_rate"]
    self._qvel[:, [*self._handles.spin_dofs, self._handles.motor_dof]] = turning
    curve = car.track_width / (2 * car.wheelbase) * self.values["ackermann_fraction"] * s["steering_angle"] ** 2
    self._qpos[:, self._handles.steering_qpos[0]] = s["steering_angle"] + curve
    self._qpos[:, self._handles.steering_qpos[1]] = s["steering_angle"] - curve
    self._act[:] = 0.0
    self._act[:, -1] = s["steering_angle"]
    self._servo_rate[:], self._told[:], self._driven[:] = 0.0, s["steering_angle"], np.nan
    self._braked[:] = np.nan
    self._yaw = start[:, 2].copy()
    self._read(signals)
    signals[:, 6:8] = 0.0

  def adopt(self, row: int, other: "MujocoCars") -> None:
    for name in _STATE:
      self.batch.bind(name)[row] = other.batch.bind(name)[0]
    self._servo_rate[row], self._yaw[row] = other._servo_rate[0], other._yaw[0]
    self._told[:, row], self._driven[:, row], self._braked[row] = (
      other._told[:, 0], other._driven[:, 0], other._braked[0]
    )  # fmt: skip

  def push(self, force: Array, signals: Array) -> None:
    cosine, sine = np.cos(signals[:, 2]), np.sin(signals[:, 2])
    self._xfrc[:, self._handles.chassis, 0] = cosine * force[:, 0] - sine * force[:, 1]
    self._xfrc[:, self._handles.chassis, 1] = sine * force[:, 0] + cosine * force[:, 1]
    self._xfrc[:, self._handles.chassis, 5] = force[:, 2]

  def hold(self, rows: Rows, drive: Array) -> None:
    self._driven[0, rows], self._driven[1, rows] = drive.T

  def advance(self, commands: Array, running: NDArray[np.intp] | None, signals: Array) -> None:
    self._ctrl[:] = commands
    self._fields.drive(commands[:, 0])
    rows = slice(None) if running is None else running
    target = np.clip(commands[:, 1], -self._limit, self._limit)
    if self._fields.led.any():
      self._lead(commands[:, 0], target, running)
    else:
      self.batch.step(running, nstep=self._substeps)
    self._told[:, rows] = np.stack([target, self._told[0]])[:, rows]
    self._driven[:, rows] = np.stack([commands[:, 0], self._driven[0]])[:, rows]
    self._read(signals)

  def _lead(self, drive: Array, target: Array, running: NDArray[np.intp] | None) -> None:
    """Steps with servos of second order or of limited rate, with speed controllers, or with what was told before for a
    part of the period: in the step in which that part ends, by their shares of the step."""
    rows = slice(None) if running is None else running
    a, b, c, d = self._fields.servo
    (step, most), led = self._fields.servo_most, self._fields.led
    old, new, hold = _held(self.values["steering_hold"], target, *self._told)
    before, now, held_drive = _held(self.values["drive_hold"], drive, *self._driven)
    for n in range(self._substeps):
      self._drive(before, now, np.clip(held_drive * self._substeps - n, 0.0, 1.0), rows)
      share = np.clip(hold * self._substeps - n, 0.0, 1.0)
      angle, rate = self._act[:, -1].copy(), self._servo_rate.copy()
      told, going = angle.copy(), np.zeros(len(angle))
      for part, held in ((share, old), (1.0 - share, new)):
        off = angle - held
        told += part * np.clip(held + a * off + b * rate - angle, -step, step)
        going += part * np.clip(c * off + d * rate, -most, most)
      self._ctrl[led, self._handles.steering] = told[led]
      self._servo_rate[rows] = going[rows]
      self.batch.step(running, nstep=1)

  def _drive(self, before: Array, now: Array, share: Array, rows: Rows) -> None:
    """Let what the drive was told before act on the motors for a share of the step, (N,), then what it is told now."""
    if self._fields.switched.any():
      emf = self.values["motor_damping"] / self.values["torque_per_volt"] * self._qvel[:, self._handles.motor_dof]
      braked = np.where(np.isnan(self._braked), self.values["braked_at_first"], self._braked)
      shares, supply = np.stack([self.values[name] for name in controller.QUANTITIES]), self._car.duty_supply
      now, after = controller.acting(now, emf, braked, shares, supply)
      if share.any():
        before, then = controller.acting(before, emf, braked, shares, supply)
        after = np.where(share < 0.5, after, then)
      self._braked[rows] = after[rows]
    self._ctrl[:, self._handles.motor] = (1.0 - share) * now + share * before
    self._fields.drive(self._ctrl[:, self._handles.motor])

  def run(self, commands: Array, periods: NDArray[np.int64], signals: Array, by_motion: ByMotion) -> bool:
    return False

  def _read(self, out: Array) -> None:
    q, v = self._qpos, self._qvel
    yaw = np.arctan2(2 * (q[:, 3] * q[:, 6] + q[:, 4] * q[:, 5]), 1 - 2 * (q[:, 5] ** 2 + q[:, 6] ** 2))
    self._yaw += np.mod(yaw - self._yaw + np.pi, 2 * np.pi) - np.pi
    cosine, sine = np.cos(yaw), np.sin(yaw)
    out[:, 0], out[:, 1], out[:, 2] = q[:, 0], q[:, 1], self._yaw
    out[:, 3] = cosine * v[:, _VX] + sine * v[:, _VY]
    out[:, 4] = -sine * v[:, _VX] + cosine * v[:, _VY]
    out[:, 5] = v[:, _YAW_RATE]
    # the sensor spoke a substep ago: its frame has turned since then by r h, on average half of it
    at, half_turn = self._handles.accelerometer, 0.5 * self._period / self._substeps * v[:, _YAW_RATE]
    ax, ay = self._sensordata[:, at], self._sensordata[:, at + 1]
    out[:, 6], out[:, 7] = ax + half_turn * ay, ay - half_turn * ax
    out[:, 8] = v[:, self._handles.motor_dof]
    out[:, 9] = 0.5 * (q[:, self._handles.steering_qpos[0]] + q[:, self._handles.steering_qpos[1]])


def _held(hold: Array, now: Array, told: Array, told_before: Array) -> tuple[Array, Array, Array]:
  """Commands that are held for so many periods, (N,), below 2: what acts first in this one, what then, and the share of
  it for which the first does. NaN among what was told is what nobody knows: the same as came after it."""
  told = np.where(np.isnan(told), now, told)
  told_before, longer = np.where(np.isnan(told_before), told, told_before), hold >= 1.0
  return np.where(longer, told_before, told), np.where(longer, told, now), hold - longer
