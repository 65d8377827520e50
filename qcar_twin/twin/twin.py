"""The physics twin: a MuJoCo car with mechanisms in slots, any number of cars side by side.

One `mujoco.batch.Batch` carries every parameter vector times every stretch of driving. Parameters
are a flat vector with names; mechanisms that are at their null are not run at all.
"""

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from qcar_twin.plant import SIGNALS, START, Prediction, Segments
from qcar_twin.twin import parameters as twin_parameters
from qcar_twin.twin.mechanisms.base import CarDimensions, Context, Mechanism, State, Track, describe, suited
from qcar_twin.twin.model_fields import Fields, Recorder, Rows
from qcar_twin.twin.timers import stop_timers
from qcar_twin.vehicle.ids import Handles
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.vehicle import TyreKind, Vehicle

Array = NDArray[np.float64]
_STEPPED = ("command", "actuator", "force", "contact")
# qpos of the free joint: position, quaternion; qvel: velocity in the world frame, rate in the body frame
_VX, _VY, _YAW_RATE = 0, 1, 5
_READ_ON = 25  # control periods after a stretch's end that sensors with fast clocks may still read


class Twin:
  """A car in MuJoCo.

  Args:
    vehicle: the car's numbers.
    mechanisms: physics added to the base car; command-stage ones act in the order given.
    tyre: "contact" for the tyre inside the contact solver, "native" for MuJoCo's own friction.
    substeps: simulation steps per control period of 10 ms (5 = 2 ms, 2 = 5 ms).
    threads: threads of the batch, 0 for all cores. Results do not depend on it.
    rows: at most this many cars are simulated side by side; more columns are done in turns.
  """

  def __init__(
    self,
    vehicle: Vehicle,
    mechanisms: Sequence[Mechanism] = (),
    tyre: TyreKind = "contact",
    substeps: int = 5,
    threads: int = 0,
    rows: int = 1024,
  ):
    stop_timers()
    self.vehicle, self.mechanisms = vehicle, suited(mechanisms, vehicle)
    self.tyre: TyreKind = tyre
    self.period, self.substeps, self.threads, self.rows = 0.01, substeps, threads, rows
    self.car = CarDimensions(**{f.name: getattr(vehicle, f.name) for f in dataclasses.fields(CarDimensions)})
    self.base = twin_parameters.base_parameters(vehicle)
    self.parameters = self.base + [p for m in self.mechanisms for p in m.parameters]
    self.model = car_spec(vehicle, tyre=tyre, timestep=self.period / substeps).compile()
    self._columns = {m.name: [self.parameters.index(p.name) for p in m.parameters] for m in self.mechanisms}
    self._rest_height = self._settle()
    self._batches: dict[int, Batch] = {}

  def __repr__(self) -> str:
    lines = [f"Twin of {self.vehicle.name}: {self.tyre} tyre, {1e3 * self.period / self.substeps:g} ms steps"]
    lines += [f"  base: {p.name} = {p.nominal:g} {p.unit}" for p in self.base]
    for m in self.mechanisms:
      lines.append(f"  {m.stage}: {m.name} ({', '.join(f'{k} [{u}]' for k, u in describe(m)['parameters'].items())})")
    return "\n".join(lines)

  def with_mechanisms(self, mechanisms: Sequence[Mechanism]) -> "Twin":
    """The same car with other mechanisms."""
    return Twin(self.vehicle, mechanisms, self.tyre, self.substeps, self.threads, self.rows)

  def begin(
    self,
    theta: Array,
    start: Array,
    history: Array | None = None,
    recording_time: Array | None = None,
    first_command: Array | None = None,
    batch: Batch | None = None,
  ) -> "Simulation":
    """N cars with parameters (N, P) at states (N, 7).

    Args:
      theta: parameter vectors, one per car.
      start: states in the order of START.
      history: seconds driven and the command's square times s spent before, (N, 2).
      recording_time: time of the start within its recording, s, (N,).
      first_command: commands that stood when the simulation starts, (N, 2): what lags and delays begin with.
      batch: what carries the cars; a new one by default, so that simulations don't disturb each other.
    """
    theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
    if theta.shape != (len(start), len(self.parameters)):
      raise ValueError(f"theta must be ({len(start)}, {len(self.parameters)}), got {theta.shape}")
    size = len(start)
    return Simulation(
      self,
      theta,
      np.asarray(start, dtype=np.float64),
      np.zeros((size, 2)) if history is None else history,
      np.zeros(size) if recording_time is None else recording_time,
      np.column_stack([np.zeros(size), start[:, 6]]) if first_command is None else first_command,
      Batch(self.model, size, self.threads) if batch is None else batch,
    )

  def rollout(self, theta: Array, segments: Segments) -> Prediction:
    """Every parameter vector, (n, P), over every segment; those that differ in sensors only share a simulation."""
    theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
    stepped, same = np.unique(self._without_sensors(theta), axis=0, return_inverse=True)
    per_turn = max(1, self.rows // len(segments))
    turns = [self._simulate(stepped[i : i + per_turn], segments) for i in range(0, len(stepped), per_turn)]
    signals = np.concatenate(turns)[same.reshape(-1)]  # (n, S, T + 1, 10)
    flat, offset = signals.reshape(-1, *signals.shape[2:]), np.tile(segments.offset, len(theta))
    self.sensed(np.repeat(theta, len(segments), axis=0), flat, offset)
    return Prediction(signals, segments.period)

  def _without_sensors(self, theta: Array) -> Array:
    """The same vectors with sensor-side mechanisms at their nominal values."""
    stepped = theta.copy()
    for mechanism in self.mechanisms:
      if mechanism.stage == "sensor" and not _moves_start(mechanism):
        stepped[:, self._columns[mechanism.name]] = [p.nominal for p in mechanism.parameters]
    return stepped

  def _simulate(self, theta: Array, segments: Segments) -> Array:
    n, size, length = len(theta), len(segments), segments.commands.shape[1]
    tile = lambda a: np.tile(a, (n,) + (1,) * (a.ndim - 1))
    commands = np.ascontiguousarray(tile(segments.commands).transpose(1, 0, 2))  # (T, n * S, 2)
    history = None if segments.history is None else tile(segments.history)
    start, offset, pose = tile(segments.start), tile(segments.offset), tile(segments.measured_pose)
    start = self._as_measured(np.repeat(theta, size, axis=0), start)
    simulation = self.begin(np.repeat(theta, size, axis=0), start, history, offset, commands[0], self.batch(n * size))
    ends = np.minimum(np.tile(segments.steps, n) + _READ_ON, length)  # after it a car rests: nothing is measured
    signals = np.empty((length + 1, n * size, len(SIGNALS)))
    signals[0] = simulation.signals
    for k in range(last := int(ends.max())):
      signals[k + 1] = simulation.step(commands[k], pose[:, k], np.flatnonzero(ends > k))
    signals[last + 1 :] = signals[last]
    return np.ascontiguousarray(signals.transpose(1, 0, 2)).reshape(n, size, length + 1, len(SIGNALS))

  def _as_measured(self, theta: Array, start: Array) -> Array:
    """Start states (N, 7) of stretches as cars with parameters (N, P) had them, given what their sensors said."""
    for mechanism in filter(_moves_start, self.mechanisms):
      rows = self.present(mechanism, theta)
      if rows is not None:
        start[rows] = mechanism.begin(theta[rows][:, self._columns[mechanism.name]], start[rows])
    return start

  def sensed(self, theta: Array, signals: Array, offset: Array) -> Array:
    """Signals (N, T + 1, 10) as the sensors of a car with parameters (N, P) show them; changed in place."""
    time = offset[:, None] + self.period * np.arange(signals.shape[1])
    for mechanism in self.mechanisms:
      if mechanism.stage == "sensor":
        rows = self.present(mechanism, theta)
        if rows is not None:
          track = Track(self.car, self.period, signals[rows], time[rows])
          signals[rows] = mechanism.measure(theta[rows][:, self._columns[mechanism.name]], track)
    return signals

  def present(self, mechanism: Mechanism, theta: Array) -> Rows | None:
    """Rows of theta, (N, P), in which a mechanism differs from its null; None if in none."""
    columns = self._columns[mechanism.name]
    null = [(c, p.null) for c, p in zip(columns, mechanism.parameters, strict=True) if p.null is not None]
    rows = np.flatnonzero(np.any([theta[:, c] != value for c, value in null], axis=0))
    if len(rows) == 0:
      return None
    return slice(int(rows[0]), int(rows[-1]) + 1) if rows[-1] - rows[0] + 1 == len(rows) else rows

  def batch(self, size: int) -> Batch:
    """A batch for rollouts of a number of cars, one at a time; kept, since making one costs more than a step."""
    if size not in self._batches:
      if len(self._batches) > 3:
        self._batches.pop(next(iter(self._batches)))
      self._batches[size] = Batch(self.model, size, self.threads)
    return self._batches[size]

  def _settle(self) -> float:
    """Height at which the nominal car stands, m."""
    data = mujoco.MjData(self.model)
    mujoco.mj_step(self.model, data, int(1.5 / self.model.opt.timestep))
    return float(data.joint("chassis").qpos[2])


def _moves_start(mechanism: Mechanism) -> bool:
  return type(mechanism).begin is not Mechanism.begin


class Simulation:
  """Cars under way. `signals` is the present state, (N, 10); `step` advances by one control period."""

  def __init__(
    self, twin: Twin, theta: Array, start: Array, history: Array, recording_time: Array, command: Array, batch: Batch
  ):
    self._twin, self._theta, self._batch = twin, theta, batch
    self._batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
    self._fields = Fields(self._batch, twin.car, twin.tyre == "native")
    self._fields.load(twin_parameters.quantities(theta, twin.base, twin.vehicle))
    self._scale = np.array([twin.vehicle.command_scale, 1.0])
    self._history, command = history * self._scale[::-1] ** 2, command * self._scale
    self._recording_time, self._time = recording_time, 0.0
    self._bind(twin.model)
    self._place(start)
    self.signals = np.zeros((len(theta), len(SIGNALS)))
    self._yaw, self._wheel_angle = start[:, 2].copy(), np.zeros(len(theta))
    self._read()
    self.signals[:, 6:8] = 0.0
    self._slots = [
      _Slot(m, rows, theta[rows][:, twin._columns[m.name]])
      for m in twin.mechanisms
      if m.stage in _STEPPED and (rows := twin.present(m, theta)) is not None
    ]
    known = np.column_stack([self.signals[:, :3], self._wheel_angle])
    for slot in self._slots:
      slot.state = slot.mechanism.initial(slot.theta, self._context(slot, command, known))
    self._write_models(command, known, first=True)

  @property
  def batch(self) -> Batch:
    """What carries the cars."""
    return self._batch

  def step(self, commands: Array, pose: Array | None = None, running: NDArray[np.intp] | None = None) -> Array:
    """Hold commands (N, 2) for one control period; returns the signals after it, (N, 10).

    Args:
      commands: drive [unit of its command], steering [rad].
      pose: measured x, y, yaw and wheel angle for effects bound to them, (N, 4); NaN or None for the simulated ones.
      running: cars that are moved on, in rising order; the others stay as they are. All by default.
    """
    known = np.column_stack([self.signals[:, :3], self._wheel_angle])
    known = known if pose is None else np.where(np.isfinite(pose), pose, known)
    commands = commands * self._scale
    acting = np.array(commands, dtype=np.float64)
    force: Array | None = None
    for slot in self._slots:
      context = self._context(slot, commands, known)
      if slot.commands:
        acting[slot.rows] = slot.mechanism.command(slot.theta, context, slot.state, acting[slot.rows])
      if slot.pushes:
        force = np.zeros((len(commands), 3)) if force is None else force
        force[slot.rows] += slot.mechanism.wrench(slot.theta, context, slot.state)
    if any(slot.mechanism.varies for slot in self._slots):
      self._write_models(commands, known, first=False)
    self._ctrl[:] = acting
    if force is not None:
      self._push(force)
    self._wheel_angle = known[:, 3] + self._twin.period * self._twin.car.gear_ratio * self.signals[:, 8]
    self._batch.step(running, nstep=self._twin.substeps)
    self._time += self._twin.period
    self._read()
    return self.signals

  def _bind(self, model: mujoco.MjModel) -> None:
    batch = self._batch
    self._qpos, self._qvel, self._ctrl, self._act = batch.qpos, batch.qvel, batch.ctrl, batch.act
    self._xfrc, self._sensordata = batch.bind("xfrc_applied"), batch.bind("sensordata")
    self._handles = Handles.of(model)

  def _place(self, start: Array) -> None:
    s = {name: start[:, i] for i, name in enumerate(START)}
    car = self._twin.car
    self._qpos[:, 0], self._qpos[:, 1], self._qpos[:, 2] = s["pose_x"], s["pose_y"], self._twin._rest_height
    self._qpos[:, 3], self._qpos[:, 6] = np.cos(s["pose_yaw"] / 2), np.sin(s["pose_yaw"] / 2)
    cosine, sine = np.cos(s["pose_yaw"]), np.sin(s["pose_yaw"])
    self._qvel[:, _VX] = cosine * s["velocity_x"] - sine * s["velocity_y"]
    self._qvel[:, _VY] = sine * s["velocity_x"] + cosine * s["velocity_y"]
    self._qvel[:, _YAW_RATE] = s["yaw_rate"]
    half = car.track_width / 2
    for k, dof in enumerate(self._handles.spin_dofs):
      side = half if k % 2 == 0 else -half
      self._qvel[:, dof] = (s["velocity_x"] - s["yaw_rate"] * side) / car.wheel_radius
    self._qvel[:, self._handles.motor_dof] = s["velocity_x"] / car.wheel_radius / car.gear_ratio
    curve = car.track_width / (2 * car.wheelbase) * self._fields.values["ackermann_fraction"] * s["steering_angle"] ** 2
    self._qpos[:, self._handles.steering_qpos[0]] = s["steering_angle"] + curve
    self._qpos[:, self._handles.steering_qpos[1]] = s["steering_angle"] - curve
    self._act[:] = 0.0
    self._act[:, -1] = s["steering_angle"]

  def _read(self) -> None:
    q, v, out = self._qpos, self._qvel, self.signals
    yaw = np.arctan2(2 * (q[:, 3] * q[:, 6] + q[:, 4] * q[:, 5]), 1 - 2 * (q[:, 5] ** 2 + q[:, 6] ** 2))
    self._yaw += np.mod(yaw - self._yaw + np.pi, 2 * np.pi) - np.pi
    cosine, sine = np.cos(yaw), np.sin(yaw)
    out[:, 0], out[:, 1], out[:, 2] = q[:, 0], q[:, 1], self._yaw
    out[:, 3] = cosine * v[:, _VX] + sine * v[:, _VY]
    out[:, 4] = -sine * v[:, _VX] + cosine * v[:, _VY]
    out[:, 5] = v[:, _YAW_RATE]
    # the sensor spoke a substep ago: its frame has turned since then by r h, on average half of it
    at, half_turn = self._handles.accelerometer, 0.5 * self._twin.period / self._twin.substeps * v[:, _YAW_RATE]
    ax, ay = self._sensordata[:, at], self._sensordata[:, at + 1]
    out[:, 6], out[:, 7] = ax + half_turn * ay, ay - half_turn * ax
    out[:, 8] = v[:, self._handles.motor_dof]
    out[:, 9] = 0.5 * (q[:, self._handles.steering_qpos[0]] + q[:, self._handles.steering_qpos[1]])

  def _context(self, slot: "_Slot", commands: Array, known: Array) -> Context:
    rows, values = slot.rows, self._fields.values
    return Context(
      car=self._twin.car,
      period=self._twin.period,
      time=self._time,
      signals=self.signals[rows],
      commands=commands[rows],
      history=self._history[rows],
      recording_time=self._recording_time[rows] + self._time,
      pose=known[rows, :3],
      wheel_angle=known[rows, 3],
      torque_per_volt=values["torque_per_volt"][rows],
      motor_damping=values["motor_damping"][rows],
    )

  def _write_models(self, commands: Array, known: Array, first: bool) -> None:
    """Let contact-stage mechanisms change the simulator, always from the fitted values."""
    dirty: set[str] = set()
    if first:
      self._untouched: dict[str, Array] = {}
    for name, value in self._untouched.items():
      self._fields.values[name][:] = value
    for slot in self._slots:
      if slot.writes and (first or slot.mechanism.varies or slot.mechanism.stage == "contact"):
        view = Recorder(self._fields, slot.rows, self._untouched)
        slot.mechanism.write_model(slot.theta, self._context(slot, commands, known), view)
        dirty |= view.changed
    if dirty:
      self._fields.write(dirty, slice(None))
    if first:
      self._batch.set_const()  # what MuJoCo derives from masses follows them

  def _push(self, force: Array) -> None:
    cosine, sine = np.cos(self.signals[:, 2]), np.sin(self.signals[:, 2])
    self._xfrc[:, self._handles.chassis, 0] = cosine * force[:, 0] - sine * force[:, 1]
    self._xfrc[:, self._handles.chassis, 1] = sine * force[:, 0] + cosine * force[:, 1]
    self._xfrc[:, self._handles.chassis, 5] = force[:, 2]


@dataclasses.dataclass
class _Slot:
  """A mechanism in the simulations where it is present."""

  mechanism: Mechanism
  rows: Rows
  theta: Array
  state: State = dataclasses.field(default_factory=dict)

  def __post_init__(self) -> None:
    kind = type(self.mechanism)
    self.commands = kind.command is not Mechanism.command
    self.pushes = kind.wrench is not Mechanism.wrench
    self.writes = kind.write_model is not Mechanism.write_model
