"""The physics twin: a car with mechanisms in slots, any number of cars side by side.

One engine carries every parameter vector times every stretch of driving. Parameters are a flat
vector with names; mechanisms that are at their null are not run at all.
"""

import copy
import functools
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal, Self

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from qcar_twin.plant import SIGNALS, START, STEERING, SUBSTEPS, Prediction, Segments
from qcar_twin.twin import parameters as twin_parameters
from qcar_twin.twin.engines import ENGINES, Engine, EngineKind, Rows
from qcar_twin.twin.engines.mujoco_cars import MujocoCars
from qcar_twin.twin.engines.reduced.cars import Numbers, ReducedCars, constants, irreducible
from qcar_twin.twin.mechanisms.base import CarDimensions, Mechanism, Track, describe, in_chain
from qcar_twin.twin.parameters import WHEELS_AT_COMMAND
from qcar_twin.twin.reading import at_one_time, in_pieces, rows_of
from qcar_twin.twin.sessions import ONE_SESSION, SessionShifts
from qcar_twin.twin.simulation import Simulation
from qcar_twin.twin.slots import Slot, moves_start, under_way
from qcar_twin.twin.starts import driven_before, driving, turned, turning
from qcar_twin.twin.suited import suited
from qcar_twin.twin.timers import stop_timers
from qcar_twin.vehicle.drive import largest_command
from qcar_twin.vehicle.mjcf import car_model, sinking
from qcar_twin.vehicle.vehicle import TyreKind, Vehicle

Array = NDArray[np.float64]
_AT_ONCE = 3  # times as many reduced cars as others side by side
_WHEELS, _ALONG = START.index("steering_angle"), START.index("velocity_x")
_READ_ON = 25  # control periods after a stretch's end that sensors with fast clocks may still read


class Twin:
  """A car as MuJoCo simulates it, or as the reduced car stands in for that.

  Args:
    vehicle: the car's numbers.
    mechanisms: physics added to the base car; those of a stage act in the order of their links.
    tyre: "contact" for the tyre inside the contact solver, "native" for MuJoCo's own friction.
    substeps: simulation steps per control period of 10 ms (5 = 2 ms, 2 = 5 ms) of a car of the QCar's class; a smaller
      car takes as many more as its time is shorter.
    threads: threads of the batch, 0 for all cores. Results do not depend on it.
    rows: at most this many cars are simulated side by side; more columns are done in turns.
    engine: "mujoco", or "reduced" for the car that is many times as fast and good enough to search with.
    sessions: parameters that differ from session to session; see sessions.py.

  Raises:
    ValueError: a mechanism presupposes another drive, or there is no such engine for this car.
  """

  def __init__(
    self,
    vehicle: Vehicle,
    mechanisms: Sequence[Mechanism] = (),
    tyre: TyreKind = "contact",
    substeps: int = SUBSTEPS,
    threads: int = 0,
    rows: int = 1024,
    engine: EngineKind = "mujoco",
    sessions: SessionShifts = ONE_SESSION,
  ):
    if engine not in ENGINES:
      raise ValueError(f"engine must be one of {', '.join(ENGINES)}, not '{engine}'")
    if substeps < 1:
      raise ValueError(f"substeps must be 1 or more, not {substeps}")
    if engine == "reduced" and (lacking := irreducible(vehicle, tyre)):
      raise ValueError(f'{vehicle.name} can\'t be simulated by the reduced car: {lacking}; use engine="mujoco"')
    stop_timers()
    self._kind: EngineKind = engine
    self.vehicle, self.mechanisms = vehicle, suited(mechanisms, vehicle)
    self._chain = in_chain(self.mechanisms)
    self.tyre: TyreKind = tyre
    self.period, self.asked_substeps, self.threads, self.rows = 0.01, substeps, threads, rows
    self.substeps = vehicle.similarity.steps(substeps)
    self.car = CarDimensions.of(vehicle)
    self.base = twin_parameters.base_parameters(vehicle)
    self.parameters = self.base + [p for m in self.mechanisms for p in m.parameters]
    self.sessions = sessions
    self.parameters = self.parameters + sessions.parameters(self.parameters)
    self.model = car_model(vehicle, tyre, self.period / self.substeps)
    self._columns = {m.name: [self.parameters.index(p.name) for p in m.parameters] for m in self.mechanisms}
    self._rest_height = self._settle()
    self._batches: dict[int, dict[int, Batch]] = {}  # by thread, then by number of cars
    self._made: Callable[[int], Engine] | None = None  # makes an external engine

  def __repr__(self) -> str:
    lines = [f"Twin of {self.vehicle.name}: {self.tyre} tyre, {1e3 * self.period / self.substeps:g} ms steps"]
    lines += [f"  base: {p.name} = {p.nominal:g} {p.unit}" for p in self.base]
    for m in self.mechanisms:
      lines.append(f"  {m.stage}: {m.name} ({', '.join(f'{k} [{u}]' for k, u in describe(m)['parameters'].items())})")
    return "\n".join(lines)

  def __getstate__(self) -> dict[str, Any]:
    """For a copy or another process: batches are made anew there."""
    return {**vars(self), "_batches": {}}

  def with_mechanisms(self, mechanisms: Sequence[Mechanism]) -> "Twin":
    """The same car with other mechanisms."""
    given = (self.vehicle, mechanisms, self.tyre, self.asked_substeps, self.threads, self.rows)
    other = Twin(*given, self._kind, self.sessions)
    return other.with_engine(self._made) if self._made else other

  def on(self, engine: EngineKind) -> "Twin":
    """The same car and mechanisms on an engine of ours; itself where it is on it."""
    given = (self.vehicle, self.mechanisms, self.tyre, self.asked_substeps, self.threads, self.rows)
    return self if engine == self.engine else Twin(*given, engine, self.sessions)

  @property
  def engine(self) -> EngineKind | Literal["external"]:
    """What moves the cars: "external" after `with_engine`."""
    return "external" if self._made else self._kind

  def with_engine(self, made: Callable[[int], Engine]) -> Self:
    """The same mechanisms and sensors around another simulator's cars; `made` gives an engine of so many cars."""
    other = copy.copy(self)
    other._made, other._batches = made, {}
    return other

  def apart(self) -> Self:
    """The same for a process without this one's threads: on one thread, with batches of its own."""
    made = copy.copy(self)
    made.threads, made._batches = 1, {}
    return made

  def begin(
    self,
    theta: Array,
    start: Array,
    history: Array | None = None,
    recording_time: Array | None = None,
    first_command: Array | None = None,
    batch: Batch | None = None,
    rim_speed: Array | None = None,
    lead: Array | None = None,
  ) -> "Simulation":
    """N cars with parameters (N, P) at states (N, 7).

    Args:
      theta: parameter vectors, one per car.
      start: states in the order of START.
      history: seconds driven and the command's square times s spent before, (N, 2).
      recording_time: time of the start within its recording, s, (N,).
      first_command: commands that stand at the start, (N, 2), for lags and delays; or K before, too, (N, K + 1, 2).
      batch: what carries MuJoCo's cars; a new one by default, so that simulations don't disturb each other.
      rim_speed: of the driven wheels at the start, their mean, m/s, (N,); by default they roll without slip.
      lead: how the cars were driven just before, (N, 4), in the order of LEAD.
    """
    theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
    if theta.shape != (len(start), len(self.parameters)):
      raise ValueError(f"theta must be ({len(start)}, {len(self.parameters)}), got {theta.shape}")
    if np.shape(start)[1:] != (len(START),):
      raise ValueError(f"start must be (N, {len(START)}), as START names it, got {np.shape(start)}")
    if not (np.isfinite(theta).all() and np.isfinite(start).all()):
      raise ValueError("theta and start must be finite numbers")
    size, start = len(start), np.asarray(start, dtype=np.float64)
    values = twin_parameters.quantities(theta, self.base, self.vehicle)
    return Simulation(
      engine=self._engine(size, batch),
      values=values,
      slots=self.slots(theta),
      car=self.car,
      period=self.period,
      scale=np.array([self.vehicle.command_scale, 1.0]),
      most=largest_command(self.vehicle.drive, self.vehicle.supply_voltage),
      start=start,
      turning=turning(start, rim_speed, values, self.vehicle),
      history=np.zeros((size, 2)) if history is None else history,
      recording_time=np.zeros(size) if recording_time is None else recording_time,
      command=np.column_stack([np.zeros(size), start[:, 6]]) if first_command is None else first_command,
      lead=lead,
    )

  def slots(self, theta: Array) -> list[Slot]:
    """Mechanisms that act while cars with parameters (N, P) are under way, where they are present."""
    return [Slot(*there) for there in self._acting(filter(under_way, self._chain), theta)]

  def _engine(self, size: int, batch: Batch | None) -> Engine:
    if self._made is not None:
      return self._made(size)
    if self.engine == "reduced":
      return ReducedCars(*self._reduced, self.car, sinking(self.vehicle), self.substeps, size, self.threads)
    carried = Batch(self.model, size, self.threads) if batch is None else batch
    return MujocoCars(carried, self.car, self.period, self.substeps, self._rest_height, self.tyre == "native")

  @functools.cached_property
  def _reduced(self) -> tuple[Numbers, Array]:
    step, nominal = self.period / self.substeps, self.base.nominal[None]
    numbers = Numbers(self.model, self.vehicle, self.car, step)
    values = twin_parameters.quantities(nominal, self.base, self.vehicle)
    return numbers, constants(self.vehicle, numbers, step, values)

  def rollout(self, theta: Array, segments: Segments) -> Prediction:
    """Every parameter vector, (n, P), over every segment; those that differ in sensors only share a simulation."""
    theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
    if not len(theta) or not len(segments):
      raise ValueError(f"nothing to drive: {len(theta)} parameter vectors over {len(segments)} segments")
    if abs(segments.period - self.period) > 1e-9:
      raise ValueError(f"this twin's control period is {self.period:g} s, and the segments' {segments.period:g} s")
    stepped, same = np.unique(self.without_sensors(theta, bool(segments.by_pose.any())), axis=0, return_inverse=True)
    rows = self.rows if self.engine == "mujoco" else _AT_ONCE * self.rows
    per_turn = max(1, rows // len(segments))
    turns = [self.simulate(stepped[i : i + per_turn], segments) for i in range(0, len(stepped), per_turn)]
    signals = turns[0] if len(turns) == 1 else np.concatenate(turns)
    signals = rows_of(signals, same.reshape(-1))  # (n, S, T + 1, 10)
    flat, offset = signals.reshape(-1, *signals.shape[2:]), np.tile(segments.offset, len(theta))
    shown = self.sensed(self._in_sessions(theta, segments), flat, offset)
    return Prediction(shown.reshape(signals.shape), segments.period)

  def without_sensors(self, theta: Array, by_pose: bool = True) -> Array:
    """The same vectors with sensor-side mechanisms at their nominal values. `by_pose`: poses say how cars start."""
    stepped = theta.copy()
    for mechanism in self.mechanisms:
      if not (under_way(mechanism) or moves_start(mechanism, by_pose)):
        stepped[:, self._columns[mechanism.name]] = [p.nominal for p in mechanism.parameters]
    return stepped

  def simulate(self, theta: Array, segments: Segments) -> Array:
    """Signals of every parameter vector over every segment before any sensor errs, (n, S, T + 1, 10)."""
    n, size, length = len(theta), len(segments), segments.commands.shape[1]
    tile = lambda a: np.tile(a, (n,) + (1,) * (a.ndim - 1))
    commands = np.ascontiguousarray(tile(segments.commands).transpose(1, 0, 2))  # (T, n * S, 2)
    start, offset, pose = tile(segments.start), tile(segments.offset), tile(segments.measured_pose)
    first = commands[0] if segments.before is None else np.hstack([tile(segments.before), commands[0, :, None]])
    theta = self._in_sessions(theta, segments)
    if segments.start_rate is not None:
      start = turned(start, theta[:, self.base.index(WHEELS_AT_COMMAND)], commands[0, :, STEERING], self.vehicle)
    each = lambda a: None if a is None else tile(a)
    by_pose, history = tile(segments.by_pose), each(segments.history)
    lead = driven_before(each(segments.lead), functools.partial(self._begun, theta, by_pose))
    start, rim = self._as_measured(theta, by_pose, start, each(segments.start_rate), each(segments.start_push))
    ends = np.minimum(np.tile(segments.steps, n) + _READ_ON, length)  # after it a car rests: nothing is measured
    groups = self._apart(theta)
    signals = np.empty((n * size if len(groups) > 1 else 0, length + 1, len(SIGNALS)))
    for rows in groups:
      some = lambda a, rows=rows: None if a is None else a[rows]
      batch = self.batch(n * size) if self.engine == "mujoco" else None
      about = offset[rows], first[rows], batch
      cars = self.begin(theta[rows], start[rows], some(history), *about, some(rim), some(lead))
      driven = cars.run(commands[:, rows], pose[rows], ends[rows])
      signals = driven if len(groups) == 1 else _with_rows(signals, rows, driven)
    signals = at_one_time(in_pieces(signals), self.period / self.substeps, self.period)
    return signals.reshape(n, size, length + 1, len(SIGNALS))

  def _in_sessions(self, theta: Array, segments: Segments) -> Array:
    """Parameters of every vector, (n, P), in every segment's session, (n * S, P)."""
    return self.sessions.apply(np.repeat(theta, len(segments), axis=0), segments.recording, self.parameters)

  def _apart(self, theta: Array) -> list[Rows]:
    """Cars that are simulated together: on the reduced car, those that must be asked how they move are apart."""
    if self.engine == "mujoco":
      return [slice(None)]
    busy = np.zeros(len(theta), dtype=bool)
    for slot in self.slots(theta):
      busy[slot.rows] |= (slot.acts and not slot.foreseen and not slot.by_motion) & ~slot.mechanism.passes(slot.theta)
    if busy.all() or not busy.any():
      return [slice(None)]
    return [np.flatnonzero(~busy), np.flatnonzero(busy)]

  def _as_measured(
    self, theta: Array, by_pose: NDArray[np.bool_], start: Array, rate: Array | None, push: Array | None
  ) -> tuple[Array, Array | None]:
    """Start states (N, 7) of stretches as cars with parameters (N, P) had them, given what their sensors said, and the
    driven wheels' speed at the rim, m/s, (N,), or None.

    Where it is known how fast these changed, `rate` per s, (N, 7), tyres slip as the car's motion there needs: as what
    they push it with, (N,) m/s^2, where that was measured. `by_pose`: states that the pose said, (N, 7).
    """
    start = self._begun(theta, by_pose, start, np.zeros_like(start) if rate is None else rate)
    if rate is None:
      return start, None
    values = {name: theta[:, i] for i, name in enumerate(self.base.names)}
    push = rate[:, _ALONG] if push is None else np.where(np.isnan(push), rate[:, _ALONG], push)
    return driving(start, self._own(theta, by_pose[:, _ALONG]), push, values, self.vehicle)

  def _own(self, theta: Array, by_pose: NDArray[np.bool_]) -> Array:
    """Share, (N,), that the car's own speed has in the measured one; all of it where the pose said it, (N,)."""
    own = by_pose.astype(np.float64)
    for mechanism, rows, values in self._acting(filter(moves_start, self._chain), theta):
      own[rows] = np.maximum(own[rows], mechanism.own_share(values))
    return own

  def _begun(self, theta: Array, by_pose: NDArray[np.bool_], start: Array, rate: Array) -> Array:
    """States (N, 7) as they were, given what was said of them and of how fast they change, in place; `by_pose`: by the
    pose, (N, 7), and not by a sensor of their own."""
    own = self._own(theta, by_pose[:, _ALONG])
    for mechanism, rows, values in self._acting(filter(moves_start, reversed(self._chain)), theta):
      moved, held = mechanism.begin(values, start[rows], rate[rows]), own[rows, None] * mechanism.of_wheels
      start[rows] = np.where(by_pose[rows] == mechanism.of_pose, moved + held * (start[rows] - moved), start[rows])
    return start

  def sensed(self, theta: Array, signals: Array, offset: Array) -> Array:
    """Signals (N, T + 1, 10) as the sensors of a car with parameters (N, P) show them. `signals` may be changed."""
    time = offset[:, None] + self.period * np.arange(signals.shape[1])
    for mechanism, rows, values in self._acting((m for m in self._chain if m.stage == "sensor"), theta):
      shown = mechanism.measure(values, Track(self.car, self.period, signals[rows], time[rows], own=True))
      signals = shown if len(shown) == len(signals) else _with_rows(signals, rows, shown)
    return signals

  def _acting(self, mechanisms: Iterable[Mechanism], theta: Array) -> Iterator[tuple[Mechanism, Rows, Array]]:
    """Those present in cars with parameters (N, P), with their rows and their parameters there, (n, p)."""
    for mechanism in mechanisms:
      if (rows := self.present(mechanism, theta)) is not None:
        yield mechanism, rows, theta[rows][:, self._columns[mechanism.name]]

  def present(self, mechanism: Mechanism, theta: Array) -> Rows | None:
    """Rows of theta, (N, P), in which a mechanism differs from its null; None if in none."""
    columns = self._columns[mechanism.name]
    null = [(c, p.null) for c, p in zip(columns, mechanism.parameters, strict=True) if p.null is not None]
    rows = np.flatnonzero(np.any([theta[:, c] != value for c, value in null], axis=0))
    if len(rows) == 0:
      return None
    return slice(int(rows[0]), int(rows[-1]) + 1) if rows[-1] - rows[0] + 1 == len(rows) else rows

  def batch(self, size: int) -> Batch:
    """A batch for rollouts of a number of cars, one at a time; kept, since making one costs more than a step.

    Every thread has batches of its own, so that several may roll out one twin at once.
    """
    me = threading.get_ident()
    if me not in self._batches:
      alive = {thread.ident for thread in threading.enumerate()}
      for gone in set(self._batches) - alive:
        self._batches.pop(gone, None)
    own = self._batches.setdefault(me, {})
    if size not in own:
      if len(own) > 3:
        own.pop(next(iter(own)))
      own[size] = Batch(self.model, size, self.threads)
    return own[size]

  def _settle(self) -> float:
    """Height at which the nominal car stands, m."""
    data = mujoco.MjData(self.model)
    mujoco.mj_step(self.model, data, int(1.5 / self.model.opt.timestep))
    return float(data.joint("chassis").qpos[2])


def _with_rows(signals: Array, rows: Rows, shown: Array) -> Array:
  signals[rows] = shown
  return signals
