"""Cars under way: mechanisms in slots, and an engine that moves what they act on."""

import dataclasses
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from qcar_twin.plant import LEAD, SIGNALS
from qcar_twin.twin.engines import Array, ByMotion, Engine
from qcar_twin.twin.engines.mujoco_cars import MujocoCars
from qcar_twin.twin.mechanisms.base import CarDimensions, Context, State
from qcar_twin.twin.mechanisms.by_motion import Resisting, Weakening
from qcar_twin.twin.slots import Recorder, Slot
from qcar_twin.twin.starts import taken

_MOTOR_SPEED, _ANGLE = SIGNALS.index("motor_speed"), SIGNALS.index("steering_angle")


def mujoco_batch(simulation: "Simulation") -> Batch:
  """What carries a simulation's cars in MuJoCo.

  Raises:
    TypeError: something else carries them.
  """
  if not isinstance(simulation.engine, MujocoCars):
    raise TypeError('these cars are not in MuJoCo; make the twin with engine="mujoco"')
  return simulation.engine.batch


class _Tiled:
  """A context of `size` cars for `count` periods, one after the other: a field is repeated once it is asked for.

  Args:
    one: of one period.
    commands, time: of all periods, (count * size, 2) and (count * size,).
  """

  def __init__(self, one: Context, count: int, size: int, commands: Array, time: Array):
    self._one, self._count, self._size = one, count, size
    self.commands, self.time = commands, time
    self.recording_time = self.over(one.recording_time) + time

  def over(self, values: Array) -> Array:
    """Values of the cars, (size, ...), for all periods, (count * size, ...)."""
    repeated = np.broadcast_to(values, (self._count, *values.shape))
    return repeated.reshape(self._count * self._size, *values.shape[1:])

  def __getattr__(self, name: str) -> Any:
    value = getattr(self._one, name)
    if isinstance(value, np.ndarray):
      value = self.over(value)
      setattr(self, name, value)
    return value

  def signal(self, name: str) -> Array:
    """One signal by name, (count * size,)."""
    return self.signals[:, SIGNALS.index(name)]


class Simulation:
  """`signals` is the present state, (N, 10); `step` advances by one control period, `run` by many.

  Args:
    engine: with as many cars; `values` are loaded into it.
    values: base quantities of the cars, see twin/parameters.py.
    slots: mechanisms that act while cars are under way, where they are present.
    car: measured numbers.  period: control period, s.
    scale: what the logged commands are multiplied by before anything else, (2,).
    most: what the scaled drive command is limited to by its supply; inf for no limit.
    lead: how they were driven before, (N, 4), in the order of LEAD; None where nobody knows.
    turning: speeds of the wheels and the motor at the start, rad/s, (N, 5).
    start, history, recording_time, command: as of `Twin.begin`.
  """

  def __init__(
    self, engine: Engine, values: dict[str, Array], slots: Sequence[Slot], car: CarDimensions, period: float,
    scale: Array, most: float, start: Array, turning: Array, history: Array, recording_time: Array, command: Array,
    lead: Array | None = None,
  ):  # fmt: skip
    self.engine, self._slots, self._car, self._period = engine, list(slots), car, period
    self._scale, self._most = scale, np.array([most, np.inf])
    self.engine.load(values)
    self._lead = np.full((len(start), len(LEAD)), np.nan)
    self._history, command = history * scale[::-1] ** 2, self._supplied(command)
    command, before = (command, None) if command.ndim == 2 else (command[:, -1], command[:, :-1])
    self._recording_time, self._time = recording_time, 0.0
    self._began: Array | None = None  # s of _time at which each car began, once some did later than others
    self.signals = np.zeros((len(start), len(SIGNALS)))
    self.engine.place(start, turning, self.signals)
    self._wheel_angle = np.zeros(len(start))
    known = np.column_stack([self.signals[:, :3], self._wheel_angle])
    self._untouched: dict[str, Array] = {}
    self._write_models(command, known, first=True, before=before)
    if lead is not None:
      self._lead = taken(lead * [scale[0], 1.0, 1.0, 1.0], self.engine.values, car)
    self._settle(command, known, before)

  def _supplied(self, commands: Array) -> Array:
    """Scaled commands (..., 2), the drive's within what its supply can give: all that follows sees no more."""
    return np.clip(commands * self._scale, -self._most, self._most)

  def _settle(self, command: Array, known: Array, before: Array | None) -> None:
    """Hidden states at the start, as if what stands there had come a long way: through the slots before each. What was
    commanded before, (N, K, 2) of `Context.before`, comes that way, too.

    Else a lag behind a trim or a bent map would begin without them, and so would the car, window by window.
    """
    arriving, standing = command.copy(), self.signals.copy()
    for slot in self._slots:
      passes = slot.mechanism.stage == "command"
      context = self._context(slot, arriving, known, None, standing) if passes else self._context(slot, command, known)
      if before is not None:
        context = dataclasses.replace(context, before=before[slot.rows])
        before = slot.held_back(before, self._period)
      slot.state = slot.mechanism.initial(slot.theta, context)
      if passes and not slot.state:
        came, angle = arriving[slot.rows], np.column_stack([arriving[slot.rows, 0], standing[slot.rows, _ANGLE]])
        arriving[slot.rows] = slot.mechanism.command(slot.theta, context, slot.state, came)
        standing[slot.rows, _ANGLE] = slot.mechanism.command(slot.theta, context, slot.state, angle)[:, 1]

  def reload(self, values: dict[str, Array], slots: Sequence[Slot]) -> None:
    """Other quantities, and mechanisms present in other cars; cars in which one was present keep its hidden state.

    A car in which one is new has to `adopt` its state.
    """
    before = {slot.mechanism.name: slot for slot in self._slots}
    for slot in slots:
      old = before.get(slot.mechanism.name)
      if old:
        slot.state = old.state_in(slot.rows, len(self.signals))
    self._slots, self._untouched = list(slots), {}
    self.engine.load(values)
    if any(slot.pushes for slot in before.values()):  # a force acts until the next, which may be of no slot now
      self.engine.push(np.zeros((len(self.signals), 3)), self.signals)
    known = np.column_stack([self.signals[:, :3], self._wheel_angle])
    self._write_models(np.zeros((len(known), 2)), known, first=True)

  def adopt(self, row: int, other: "Simulation") -> None:
    """Put one car into the state of the only car of another simulation of the same twin; its quantities stay."""
    self.engine.adopt(row, other.engine)
    self.signals[row], self._wheel_angle[row] = other.signals[0], other._wheel_angle[0]
    self._history[row], self._recording_time[row] = other._history[0], other._recording_time[0]
    self._began = np.zeros(len(self.signals)) if self._began is None else self._began
    self._began[row] = self._time - other._time
    theirs = {slot.mechanism.name: slot for slot in other._slots}
    for slot in self._slots:
      if slot.mechanism.name in theirs:
        slot.adopt(row, theirs[slot.mechanism.name])

  def step(self, commands: Array, pose: Array | None = None, running: NDArray[np.intp] | None = None) -> Array:
    """Hold commands (N, 2) for one control period; returns the signals after it, (N, 10).

    Args:
      commands: drive [unit of its command], steering [rad].
      pose: measured x, y, yaw and wheel angle for effects bound to them, (N, 4); NaN or None for the simulated ones.
      running: cars that are moved on, in rising order; the others stay as they are. All by default.

    Raises:
      ValueError: commands of another shape, or that are no numbers.
    """
    commands = np.asarray(commands, dtype=np.float64)
    if commands.shape != (len(self.signals), 2):
      raise ValueError(f"commands must be ({len(self.signals)}, 2), drive and steering of each car: {commands.shape}")
    if not np.isfinite(commands).all():
      car = int(np.flatnonzero(~np.isfinite(commands).all(axis=1))[0])
      raise ValueError(f"command {commands[car].tolist()} of car {car}: give finite numbers")
    commands = self._supplied(commands)
    return self._step(commands, np.array(commands, dtype=np.float64), self._slots, pose, running)

  def run(self, commands: Array, pose: Array, periods: NDArray[np.int64]) -> Array:
    """Hold commands (T, N, 2), one control period each; returns all signals, (N, T + 1, 10).

    Args:
      pose: as of `step`, (N, >= T, 4).
      periods: how many each car drives, (N,); it keeps its last signals afterwards.
    """
    length, size = len(commands), len(self.signals)
    signals = np.empty((size, length + 1, len(SIGNALS)))
    signals[:, 0] = self.signals
    last, logged = int(periods.max()), self._supplied(commands)
    acting, slots = self._foreseen(logged, last)
    by_motion = self._by_motion(slots, logged[:last])
    if by_motion is not None and self.engine.run(acting, periods, signals, by_motion[0]):
      for slot, state in by_motion[1]:
        slot.state = state
      moved = np.where(np.arange(length) < periods[:, None], signals[:, :-1, _MOTOR_SPEED], 0.0).sum(axis=1)
      self._wheel_angle = self._wheel_angle + self._period * self._car.gear_ratio * moved
      self._time += self._period * last
      self.signals[:] = signals[:, -1]
      return signals
    running: NDArray[np.intp] | None = None
    for k in range(last):
      if running is None or periods[running].min() <= k:
        running = np.flatnonzero(periods > k)
      signals[:, k + 1] = self._step(logged[k], acting[k], slots, pose[:, k], running)
    signals[:, last + 1 :] = signals[:, last : last + 1]
    return signals

  def _foreseen(self, logged: Array, periods: int) -> tuple[Array, list[Slot]]:
    """Commands (T, N, 2) as the first slots that don't ask how the car moves leave them, and the other slots.

    The first of each command: what is done to the steering does not wait for what is done to the drive.
    """
    acting = np.array(logged, dtype=np.float64)
    ahead: list[Slot] = []
    unknown: frozenset[int] = frozenset()
    for slot in self._slots:
      if slot.acts and slot.foreseen and not slot.columns & unknown:
        ahead.append(slot)
      else:
        unknown |= slot.columns
    blind = np.full((len(self.signals), len(SIGNALS)), np.nan)
    nowhere = np.full((len(blind), 4), np.nan)
    times = self._time + np.cumsum(np.full(periods, self._period)) - self._period
    for slot in ahead:
      if not slot.state:  # nothing is carried from period to period: all of them at once
        self._at_once(slot, logged[:periods], acting[:periods], times)
        continue
      for k in range(periods):
        context = self._context(slot, logged[k], nowhere, times[k], blind)
        acting[k][slot.rows] = slot.mechanism.command(slot.theta, context, slot.state, acting[k][slot.rows])
    return acting, [slot for slot in self._slots if slot not in ahead]

  def _by_motion(self, slots: Sequence[Slot], logged: Array) -> tuple[ByMotion, list[tuple[Slot, State]]] | None:
    """What slots do to cars that got commands (T, N, 2), and their states afterwards; None where some must be asked in
    every period.

    A motor weakens once at most: with two mechanisms that do so, the second answers to what the first leaves.
    """
    acting = [slot for slot in slots if slot.acts]
    fading = [slot for slot in acting if isinstance(slot.mechanism, Weakening)]
    if not all(slot.by_motion for slot in acting) or len(fading) > 1:
      return None
    drag, weakened = np.zeros(len(self.signals)), None
    for slot in acting:
      if isinstance(slot.mechanism, Resisting):
        drag[slot.rows] += slot.mechanism.drag(slot.theta)
    after = [(slot, {name: values.copy() for name, values in slot.state.items()}) for slot in fading]
    for slot, state in after:
      assert isinstance(slot.mechanism, Weakening)
      weakened = np.ones((len(logged), len(drag), 2))
      weakened[:, slot.rows] = slot.mechanism.weakened(slot.theta, logged[:, slot.rows, 0], self._period, state)
    return ByMotion(drag, weakened), after

  def _at_once(self, slot: Slot, logged: Array, acting: Array, times: Array) -> None:
    """Commands (T, N, 2) of a mechanism without hidden state, in place."""
    count, size = len(logged), len(slot.theta)
    blind, nowhere = np.full((len(self.signals), len(SIGNALS)), np.nan), np.full((len(self.signals), 4), np.nan)
    since = np.zeros(size) if self._began is None else self._began[slot.rows]
    one, time = self._context(slot, logged[0], nowhere, 0.0, blind), (times[:, None] - since).reshape(-1)
    one.recording_time = self._recording_time[slot.rows]
    context = _Tiled(one, count, size, logged[:, slot.rows].reshape(-1, 2), time)
    came, theta = acting[:, slot.rows].reshape(-1, 2), context.over(slot.theta)
    told = slot.mechanism.command(theta, cast(Context, context), slot.state, came)
    acting[:, slot.rows] = told.reshape(count, size, 2)

  def _step(
    self, logged: Array, acting: Array, slots: Sequence[Slot], pose: Array | None, running: NDArray[np.intp] | None
  ) -> Array:
    """One control period of cars that got the commands `logged`, of which `acting` has got to these slots, (N, 2)."""
    known = np.column_stack([self.signals[:, :3], self._wheel_angle])
    known = known if pose is None else np.where(np.isfinite(pose), pose, known)
    force: Array | None = None
    for slot in slots:
      if not (slot.commands or slot.pushes):
        continue
      context = self._context(slot, logged, known)
      if slot.commands:
        acting[slot.rows] = slot.mechanism.command(slot.theta, context, slot.state, acting[slot.rows])
        if "held" in slot.state:
          self.engine.hold(slot.rows, slot.state["held"])
      if slot.pushes:
        force = np.zeros((len(logged), 3)) if force is None else force
        force[slot.rows] += slot.mechanism.wrench(slot.theta, context, slot.state)
    if any(slot.mechanism.varies for slot in slots):
      self._write_models(logged, known, first=False)
    if force is not None:
      self.engine.push(force, self.signals)
    self._wheel_angle = known[:, 3] + self._period * self._car.gear_ratio * self.signals[:, _MOTOR_SPEED]
    self.engine.advance(acting, running, self.signals)
    self._time += self._period
    return self.signals

  def _context(
    self, slot: Slot, commands: Array, known: Array, time: float | None = None, signals: Array | None = None
  ) -> Context:
    rows, values = slot.rows, self.engine.values
    time = self._time if time is None else time
    since: Any = time if self._began is None else time - self._began[rows]
    return Context(
      car=self._car,
      period=self._period,
      time=since,
      signals=(self.signals if signals is None else signals)[rows],
      commands=commands[rows],
      history=self._history[rows],
      recording_time=self._recording_time[rows] + since,
      pose=known[rows, :3],
      wheel_angle=known[rows, 3],
      torque_per_volt=values["torque_per_volt"][rows],
      motor_damping=values["motor_damping"][rows],
      max_torque=values["max_torque"][rows] if "max_torque" in values else np.inf,
      drive_hold=values["drive_hold"][rows],
      lead=self._lead[rows],
    )

  def _write_models(self, commands: Array, known: Array, first: bool, before: Array | None = None) -> None:
    """Let contact-stage mechanisms change the simulator, always from the fitted values.

    Afterwards only those that vary write again, and those that share a quantity with them.
    """
    slots = [slot for slot in self._slots if slot.writes]
    again: set[str] = set() if first else set().union(*(s.touched for s in slots if s.mechanism.varies))
    if not first:
      while more := set().union(*(s.touched for s in slots if s.touched & again)) - again:
        again |= more
      slots = [slot for slot in slots if slot.mechanism.varies or slot.touched & again]
    for name in again:
      self.engine.values[name][:] = self._untouched[name]
    dirty: set[str] = set()
    for slot in slots:
      view = Recorder(self.engine.values, slot.rows, self._untouched)
      context = self._context(slot, commands, known)
      context = context if before is None else dataclasses.replace(context, before=before[slot.rows])
      slot.mechanism.write_model(slot.theta, context, view)
      slot.touched |= view.changed
      dirty |= view.changed
    if dirty:
      self.engine.write(dirty, slice(None))
    if first:
      self.engine.commit()
