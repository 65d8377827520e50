"""The fit against `mujoco.sysid`: same residual, same parameters, same recordings, same start.

sysid compiles a model for every column of a Jacobian; the twin's columns and recordings ride in one batch that is
never compiled again. Both get a car's voltage, steering and measured start, and answer motor speed, yaw rate and
lateral acceleration every 10 ms, each divided by a standard deviation. A third fit is what the commands do: the search
is on the reduced car, and only what MuJoCo confirms counts. sysid needs packages of its own
(`mujoco[sysid]`); where they are missing its way of working is timed instead: `mujoco.minimize`, sysid's default
optimiser, on models compiled per column and rolled out in threads. Which of the two it was is said.
"""

import dataclasses
import io
import os
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from mujoco import minimize, rollout, sysid
from numpy.typing import NDArray

from calibration.concealed.benchmarks.speed import Pair
from calibration.fitting.optimiser import fit
from calibration.fitting.surrogate import Surrogate
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.plant import SIGNALS, START, SUBSTEPS, Segments
from qcar_twin.twin.simulation import mujoco_batch
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.ids import Handles
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.tyre import COLUMN
from qcar_twin.vehicle.vehicle import QCAR, WHEELS

Array = NDArray[np.float64]

# fitted as shares of the car's nominal numbers, so that steps of sysid's finite differences suit all of them
FITTED = (
  "torque_per_volt",
  "driveline_friction",
  "cornering_stiffness_front",
  "cornering_stiffness_rear",
  "yaw_inertia",
)
TRUTH = np.array([1.2, 0.7, 0.8, 1.2, 1.15])
CHANNELS = {"motor_speed": 2.0, "yaw_rate": 0.02, "accel_y": 0.1}  # and their standard deviations
LOWER, UPPER = 0.2, 5.0
CONFIRMED = 1.0  # nat: what the last correction by MuJoCo gains
CLOSE = 1.02  # a fit is there when its cost is within this factor of the best one of both
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_SCALE = np.array(list(CHANNELS.values()))
_SHARES = ParameterSet(Parameter(name, 1.0, LOWER, UPPER, "-", typical=0.3) for name in FITTED)


@dataclasses.dataclass(frozen=True, eq=False)
class Scenario:
  """What both fits are given: recordings that a car with other parameters made, noise added; measured is (S, T, 3)."""

  twin: Twin
  segments: Segments
  measured: Array

  def residual(self, shares: Array, twin: Twin | None = None) -> Array:
    """Whitened residuals (n, M) of parameters (n, p), simulated by the twin, or by another, in one batch."""
    predicted = predict(twin or self.twin, self.segments, shares)
    return ((predicted - self.measured) / _SCALE).reshape(len(shares), -1)


def parameters_of(twin: Twin, shares: Array) -> Array:
  """All parameters (n, P) of shares (n, p)."""
  theta = np.tile(twin.parameters.nominal, (len(shares), 1))
  theta[:, [twin.parameters.index(name) for name in FITTED]] *= shares
  return theta


def predict(twin: Twin, segments: Segments, shares: Array) -> Array:
  """The three channels every 10 ms, (n, S, T, 3)."""
  signals = twin.rollout(parameters_of(twin, shares), segments).signals[:, :, 1:]
  return np.stack([signals[..., SIGNALS.index(c)] for c in CHANNELS], axis=-1)


def make_task(recordings: int = 6, seconds: float = 5.0, seed: int = 0) -> Scenario:
  """Drives with a voltage and a steering angle that change every half second."""
  rng = np.random.default_rng(seed)
  twin = Twin(QCAR, substeps=SUBSTEPS)
  steps, held = int(seconds / twin.period), int(0.5 / twin.period)
  levels = rng.uniform((0.8, -0.2), (2.0, 0.2), (recordings, steps // held + 1, 2))
  commands = np.repeat(levels, held, axis=1)[:, :steps]
  start = np.zeros((recordings, len(START)))
  start[:, START.index("velocity_x")] = 0.8
  start[:, START.index("steering_angle")] = commands[:, 0, 1]
  names = tuple(f"drive {k}" for k in range(recordings))
  segments = Segments(commands, start, np.full(recordings, steps), twin.period, names, np.zeros(recordings))
  clean = predict(twin, segments, TRUTH[None])[0]
  return Scenario(twin, segments, clean + _SCALE * rng.normal(size=clean.shape))


def fit_pairs(recordings: int = 6, seconds: float = 5.0, seed: int = 0) -> tuple[Pair, Pair, Pair]:
  """sysid over the project's fits, all with their default settings: seconds until the batched one returns, until it is
  at the same cost, and until the search on the reduced car is, confirmed by MuJoCo."""
  task = make_task(recordings, seconds, seed)
  task.residual(np.ones((1, len(FITTED))))  # batches are made
  sysid_trace, *own = (_trace(lambda tell, run=run: run(task, tell)) for run in (by_sysid, by_batch, by_default))
  best = min(moment.cost for trace in (sysid_trace, *own) for moment in trace)
  there = lambda trace: next(moment for moment in trace if moment.cost <= CLOSE * best)
  library = "mujoco.sysid" if library_available() else "sysid's way, without its library"
  name = f"fit of {len(FITTED)} parameters to {recordings} recordings of {seconds:g} s"

  def pair(what: str, side: str, first: Cost, second: Cost, note: str) -> Pair:
    wall = first.wall, second.wall
    note = f"{note}; ratio of processor time {first.busy / second.busy:.2f}"
    return Pair(f"{name}, {what}", (library, side), wall, "fit", wall[0] / wall[1], 10.0, False, note)

  ends = f"costs {sysid_trace[-1].cost:.0f} and {own[0][-1].cost:.0f}, a perfect model's {task.measured.size / 2:.0f}"
  close = f"within {100 * (CLOSE - 1):.0f} % of the best one"
  return (
    pair("until it returns", "batched fit", sysid_trace[-1], own[0][-1], ends),
    pair("to the same cost", "batched fit", there(sysid_trace), there(own[0]), close),
    pair("to the same cost", "on the reduced car", there(sysid_trace), there(own[1]), f"{close}, confirmed by MuJoCo"),
  )


@dataclasses.dataclass(frozen=True)
class Cost:
  """A cost that a fit reported, and seconds on the wall and of the processors since its start."""

  wall: float
  busy: float
  cost: float


def library_available() -> bool:
  """Whether sysid's own packages are installed; without them its module is empty."""
  return hasattr(sysid, "optimize")


def _trace(run: Callable[[Callable[[float], None]], float]) -> list[Cost]:
  """Whenever a fit tells its cost, and when it returns."""
  trace: list[Cost] = []
  wall, busy = time.perf_counter(), time.process_time()
  tell = lambda cost: trace.append(Cost(time.perf_counter() - wall, time.process_time() - busy, cost))
  tell(run(tell))
  return trace


def by_batch(task: Scenario, tell: Callable[[float], None]) -> float:
  """The project's fit; returns its cost."""
  return fit(task.residual, _SHARES, robust=np.inf, progress=lambda k, cost: tell(cost)).data_cost


def by_default(task: Scenario, tell: Callable[[float], None]) -> float:
  """The fit as the commands make it: a search on the reduced car, from where it ends another on the reduced car put
  right by MuJoCo there, until that gains next to nothing. Only costs by MuJoCo are told; returns the least."""
  stand_in, at, least = Surrogate(task.twin), _SHARES.nominal, np.inf
  while True:
    tried = fit(lambda shares, s=stand_in: task.residual(shares, s), _SHARES, at, robust=np.inf).theta
    stand_in = stand_in.at(parameters_of(task.twin, tried[None])[0])
    cost = 0.5 * float(np.sum(np.square(task.residual(tried[None], stand_in))))  # there it is MuJoCo
    if cost > least - CONFIRMED:
      return min(cost, least)
    tell(cost)
    least, at = cost, tried


def by_sysid(task: Scenario, tell: Callable[[float], None]) -> float:
  """`mujoco.sysid.optimize`, or its optimiser where its packages are missing; returns its cost."""
  car = RecompiledCar(task)
  hear = lambda trace: tell(float(trace[-1].objective - trace[-1].reduction))
  if library_available():
    params, residual = car.library_problem()
    optimum, _ = sysid.optimize(params, residual, verbose=False, iter_callback=hear, output=io.StringIO())
    x = optimum.as_vector()
  else:
    size = (len(FITTED), 1)
    bounds, quiet = [np.full(size, LOWER), np.full(size, UPPER)], minimize.Verbosity.SILENT
    x, _ = minimize.least_squares(
      np.ones(len(FITTED)), car.residual, bounds, max_iter=200, verbose=quiet, iter_callback=hear
    )
  return 0.5 * float(np.sum(np.square(car.residual(np.ravel(x)))))


class RecompiledCar:
  """The car as sysid works with it: an MjSpec, edited and compiled for every parameter vector and recording."""

  def __init__(self, task: Scenario):
    self._task = task
    self._spec = car_spec(QCAR, timestep=task.twin.period / SUBSTEPS)
    model = self._spec.compile()
    handles = Handles.of(model)
    self._motor, self._yaw = 1 + model.nq + handles.motor_dof, 1 + model.nq + 5
    self._accelerometer = handles.accelerometer
    self._control = np.repeat(task.segments.commands, SUBSTEPS, axis=1)  # (S, T * SUBSTEPS, 2)
    self._start = self._starts(model)

  def _starts(self, model: mujoco.MjModel) -> list[Array]:
    """Full state of every recording's start, as the twin places its cars."""
    twin, segments = self._task.twin, self._task.segments
    cars = twin.begin(np.tile(twin.parameters.nominal, (len(segments), 1)), segments.start)
    batch, data, states = mujoco_batch(cars), mujoco.MjData(model), []
    for k in range(len(segments)):
      data.qpos[:], data.qvel[:], data.act[:] = batch.qpos[k], batch.qvel[k], batch.act[k]  # what the first step takes
      state = np.empty(mujoco.mj_stateSize(model, _STATE))
      mujoco.mj_getState(model, data, state, _STATE)
      states.append(state)
    return states

  def build(self, shares: Array) -> mujoco.MjModel:
    """A model with parameters (p,)."""
    return edited(self._spec.copy(), shares).compile()

  def observed(self, state: Array, sensors: Array) -> Array:
    """The three channels every 10 ms from states and sensors after every step, (T, 3).

    The accelerometer spoke a step before the state; its frame has turned by r h since then, on average by half of it.
    What it said is of the step's middle and goes on to its end, as in qcar_twin/twin/reading.py.
    """
    rows = slice(SUBSTEPS - 1, None, SUBSTEPS)
    yaw_rate = state[rows, self._yaw]
    half_turn = 0.5 * self._spec.option.timestep * yaw_rate
    accel_y = sensors[rows, self._accelerometer + 1] - half_turn * sensors[rows, self._accelerometer]
    accel_y[:-1] += 0.5 / SUBSTEPS * np.diff(accel_y)
    return np.column_stack([state[rows, self._motor], yaw_rate, accel_y])

  def residual(self, x: Array) -> Array:
    """(p,) or (p, n) -> (M,) or (M, n), as mujoco.minimize calls it: models per column and recording, rolled out in
    threads."""
    columns = x.reshape(len(FITTED), -1).T
    out = []
    for k, start in enumerate(self._start):
      models = [self.build(shares) for shares in columns]
      datas = [mujoco.MjData(models[0]) for _ in range(os.cpu_count() or 1)]
      controls = np.repeat(self._control[k : k + 1], len(models), axis=0)
      states, sensors = rollout.rollout(models, datas, np.tile(start, (len(models), 1)), controls)
      observed = np.stack([self.observed(*pair) for pair in zip(states, sensors, strict=True)])  # pyright: ignore[reportArgumentType]
      out.append(((observed - self._task.measured[k]) / _SCALE).reshape(len(columns), -1))
    whole = np.concatenate(out, axis=1).T
    return whole if x.ndim > 1 else whole[:, 0]

  def library_problem(self) -> tuple[Any, Callable[..., Any]]:
    """The same for `mujoco.sysid`: its parameters and its residual function."""
    times = np.arange(self._control.shape[1] + 1) * self._task.twin.period / SUBSTEPS
    mapping = {name: (sysid.SignalType.CustomObs, [k]) for k, name in enumerate(CHANNELS)}
    held = np.concatenate([self._control, self._control[:, -1:]], axis=1)
    motions = {"motor_ctrl": (sysid.SignalType.MjCtrl, [0]), "steering_ctrl": (sysid.SignalType.MjCtrl, [1])}
    sequences = sysid.ModelSequences(
      "car",
      self._spec,
      list(self._task.segments.recording),
      self._start,
      [sysid.TimeSeries.create(times, control, motions) for control in held],  # pyright: ignore[reportArgumentType]
      [sysid.TimeSeries.create(np.arange(len(m)) * 0.01, m, mapping) for m in self._task.measured],  # pyright: ignore[reportArgumentType]
      allow_missing_sensors=True,
    )

    def compare(params, predicted, measured, model, everything, state, **kwargs):
      observed = self.observed(state, predicted.data)
      return ((observed - measured.data) / _SCALE).ravel(), measured, measured

    def build(params, spec):
      return edited(spec.copy(), params.as_vector()).compile()

    params = sysid.ParameterDict({n: sysid.Parameter(n, 1.0, LOWER, UPPER) for n in FITTED})
    whole = sysid.build_residual_fn(
      models_sequences=[sequences], build_model=build, modify_residual=compare, resample_true=False
    )
    return params, whole


def edited(spec: mujoco.MjSpec, shares: Array) -> mujoco.MjSpec:
  """The car's specification with parameters (p,) written into it."""
  torque, friction, front, rear, yaw_inertia = (float(x) for x in shares)
  strength = torque * QCAR.torque_per_volt
  constant = QCAR.motor_damping / strength
  spec.actuator("motor").gainprm[:2] = [constant / strength, constant]
  spec.joint("motor").frictionloss = friction * QCAR.driveline_friction
  for wheel in WHEELS:
    tyre = np.array(spec.geom(wheel).userdata)
    tyre[COLUMN["cornering_stiffness"]] *= front if wheel.startswith("front") else rear
    spec.geom(wheel).userdata = tyre
  chassis = spec.body("chassis")
  roll, pitch, yaw = chassis.inertia
  yaw += (yaw_inertia - 1.0) * QCAR.yaw_inertia
  chassis.inertia = [roll, max(pitch, yaw - 0.95 * roll), yaw]
  return spec
