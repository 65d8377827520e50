"""Sessions: cars, manoeuvres and concealed effects in; recordings, the vehicle table and the sealed truth out."""

from __future__ import annotations

from dataclasses import dataclass, fields
from types import SimpleNamespace

import numpy as np

from ..laboratory.designs import plan
from ..laboratory.driver import BELIEFS, Driver, coloured, hands
from ..laboratory.manoeuvres import PERIOD, Manoeuvre
from ..laboratory.written import Session, as_recording, stream
from .car import Car, armature, describe, fleet, one_of
from .drivetrain import CHANNEL, LIMIT, STEP
from .effects import Effect, effect_class
from .gaps import gaps
from .sensing import RESOLUTION, Log, Sensors, add_noise
from .simulation import TRACE, Carried, Simulation
from .wild import DESIGN as WILD
from .wild import draw_wild_car, draw_wild_sensors, known_of_it, scaled

WIDEST = 800_000  # ticks x cars of one simulation: its trace takes 350 MB
PAUSE = 15.0  # s between two runs
FORCE_NOISE = ((0.05, 0.07, 0.004), 0.15)  # N, N, N m rms on the body; s memory
LOAD_NOISE = (0.03, 0.06)  # relative rms of each wheel's load; s memory

CLEAR = (
  "steering_delay",
  "steering_lag",
  "steering_offset",
  "steering_gain_error",
  "steering_asymmetry",
  "steering_dead_zone",
  "steering_backlash",
  "drive_delay",
  "drive_lag",
  "drive_asymmetry",
  "coast_freewheel",
  "battery_sag",
  "steering_drag",
  "differential_lock",
  "tyre_relaxation",
  "imu_latency",
  "gyro_scale",
  "imu_misalignment",
  "floor_slope",
)  # effects that leave strong evidence in the laboratory design, which a refit of the car's parameters does not absorb


@dataclass(frozen=True)
class Spec:
  """What to make. `effects`: (id, size in multiples of the typical one); `noise` scales sensor and process noise."""

  seed: int
  effects: tuple[tuple[str, float], ...] = ()
  design: str = "lab"
  noise: float = 1.0
  car: Car | None = None  # drawn, of the kind the design is for


@dataclass
class _Draft:
  """A session before it is driven: everything that its own seed decides."""

  spec: Spec
  car: Car
  runs: list[Manoeuvre]
  vehicle: dict[str, float | str]
  vehicle_std: dict[str, float]
  shaking: np.ndarray  # (T, 4, n)
  disturbance: np.ndarray  # (T, 7, n)
  columns: slice
  effects: tuple[Effect, ...] = ()
  sensors: Sensors = Sensors()


def make_session(
  seed: int,
  effects: tuple[tuple[str, float], ...] = (),
  design: str = "lab",
  noise: float = 1.0,
  car: Car | None = None,
) -> Session:
  """One session, the same bit for bit for the same arguments."""
  return make_sessions([Spec(seed, tuple(effects), design, noise, car)])[0]


def make_sessions(specs: list[Spec]) -> list[Session]:
  """Several sessions side by side in one simulation; each equals what `make_session` gives for it alone."""
  sessions: list[Session] = []
  while len(sessions) < len(specs):
    sessions += _together(specs[len(sessions) :])
  return sessions


def _together(specs: list[Spec]) -> list[Session]:
  """As many of the first specs as fit into one simulation's trace."""
  drafts, columns, longest = [], 0, 0
  for spec in specs:
    draft = _draft(spec, columns)
    columns, longest = draft.columns.stop, max(longest, len(draft.shaking))
    if drafts and columns * longest > WIDEST:
      break
    drafts.append(draft)
  sim, commands = _drive(drafts)
  log = Log(sim, max(len(draft.shaking) for draft in drafts))
  return [_collect(draft, log, commands[:, :, draft.columns]) for draft in drafts]


def _draft(spec: Spec, first: int) -> _Draft:
  car = spec.car or drawn_car(spec)
  vehicle, std = car.measured(stream(spec.seed, 1))
  runs, sensors = plan(spec.design, stream(spec.seed, 2)), Sensors()
  if spec.design == WILD:
    runs, sensors = [scaled(run, car) for run in runs], draw_wild_sensors(stream(spec.seed, 7))
    vehicle, std = known_of_it(vehicle, std)
  ticks, n = max(run.ticks for run in runs), len(runs)
  hand = hands(stream(spec.seed, 3), runs)
  rng = stream(spec.seed, 4)
  body = coloured(rng, (ticks, 3, n), FORCE_NOISE[1]) * np.array(FORCE_NOISE[0])[:, None] * (car.mass / 2.7)
  floor = coloured(rng, (ticks, 4, n), LOAD_NOISE[1]) * LOAD_NOISE[0]
  columns = slice(first, first + n)
  chosen = [(name, size) for name, size in spec.effects if size != 0.0]
  effects = tuple(
    effect_class(name)(size, columns, stream(spec.seed, 100 + i)) for i, (name, size) in enumerate(chosen)
  )
  for name, _ in spec.effects:
    effect_class(name)
  return _Draft(
    spec, car, runs, vehicle, std, hand, spec.noise * np.concatenate([body, floor], axis=1), columns, effects, sensors
  )


def drawn_car(spec: Spec) -> Car:
  """A car of the kind the design is for."""
  kind, _, command = spec.design.partition("vesc_")
  rng = stream(spec.seed, 0)
  if spec.design == WILD:
    return draw_wild_car(rng)
  return Car.draw(rng) if kind or not command else Car.draw_f1tenth(rng, "rear", command)


def _drive(drafts: list[_Draft]) -> tuple[Simulation, np.ndarray]:
  """All runs of all drafts at once, from start to the end of the longest; with the commands given (T, 2, N)."""
  longest = max(len(draft.shaking) for draft in drafts)

  def padded(name: str) -> np.ndarray:
    return np.concatenate(
      [np.pad(a := getattr(d, name), ((0, longest - len(a)), (0, 0), (0, 0))) for d in drafts], axis=2
    )

  runs = [run for draft in drafts for run in draft.runs]
  cars = fleet([draft.car for draft in drafts], [len(draft.runs) for draft in drafts])
  sim = Simulation(cars, tuple(effect for draft in drafts for effect in draft.effects))
  driver = Driver(runs, padded("shaking"), _belief(drafts))
  disturbance = padded("disturbance")
  start = np.array(
    [[*run.start[:3], run.start[3], 0.0, 0.0, run.steer[0] if run.start[3] > 0 else 0.0] for run in runs]
  )
  wheelbase = cars.cg_to_front + cars.cg_to_rear
  start[:, 5] = start[:, 3] * np.tan(start[:, 6]) / wheelbase
  start[:, 4] = start[:, 5] * cars.cg_to_rear
  longer = [_carried(draft) for draft in drafts]
  carried = Carried(*(np.concatenate([getattr(c, f.name) for c in longer]) for f in fields(Carried)))
  x, y, yaw, speed = start[:, :4].T
  command = driver.commands(0, x, y, yaw, speed / (cars.wheel_radius * cars.gear_ratio))
  sim.begin(start, command, carried, longest)
  state = sim.dynamics.state
  commands = np.empty((longest, 2, len(runs)))
  for k in range(longest):
    commands[k] = command
    sim.advance(command, disturbance[k])
    if k + 1 < longest:
      command = driver.commands(k + 1, state.x, state.y, state.yaw, state.motor)
  return sim, commands


def _belief(drafts: list[_Draft]) -> SimpleNamespace:
  """What the driver reckons with: the measured geometry and a feel for the drive that is a few per cent off."""
  rows = []
  for draft in drafts:
    line, v = draft.car.linearised(), draft.vehicle
    feel = 1 + 0.03 * stream(draft.spec.seed, 5).standard_normal(2)
    per_motor = float(v["gear_ratio"]) * float(v["wheel_radius"])
    command = draft.car.drivetrain.command
    answer = {"voltage": 1.0, "speed": 0.0}.get(command, 3.0 / (line["P1"] * per_motor))
    rows.append(
      (
        float(v["cg_to_front"]) + float(v["cg_to_rear"]),
        per_motor,
        1.0 if command == "speed" else feel[0] * line["P2"] / line["P1"] / per_motor,
        0.0 if command == "speed" else feel[1] * line["P3"] / line["P1"],
        v["max_steering"],
        answer,
        1.0 if command == "speed" else answer,
        LIMIT[command],
        STEP[command],
      )
    )
  table = np.repeat(np.array(rows), [len(draft.runs) for draft in drafts], axis=0)
  return SimpleNamespace(**dict(zip(BELIEFS, table.T, strict=True)))


def _carried(draft: _Draft) -> Carried:
  """Heat, charge and time at the start of each run, from a straight-line reckoning of the runs before it."""
  loss, charge = _reckon(draft.car, draft.runs)
  n, driven = len(draft.runs), np.array([run.ticks * PERIOD for run in draft.runs])
  heat, memory = np.zeros(n), draft.car.heat_capacity * draft.car.heat_resistance
  for i in range(1, n):
    heat[i] = (heat[i - 1] + loss[i - 1] / draft.car.heat_capacity) * np.exp(-(driven[i - 1] + PAUSE) / memory)
  started, used = np.cumsum(driven + PAUSE) - driven - PAUSE, np.cumsum(charge) - charge
  length, drawn, mean_loss = driven.sum() + n * PAUSE, charge.sum(), loss.sum() / driven.sum()
  return Carried(heat, used, started, np.full(n, length), np.full(n, drawn), np.full(n, mean_loss))


def _reckon(car: Car, runs: list[Manoeuvre]) -> tuple[np.ndarray, np.ndarray]:
  """Loss in the armature [J] and charge [C] of each run (n,), from the linearised drive."""
  line, per_motor, longest = car.linearised(), car.gear_ratio * car.wheel_radius, max(run.ticks for run in runs)
  motor, loss, charge = np.array([run.start[3] / per_motor for run in runs]), np.zeros(len(runs)), np.zeros(len(runs))
  wish = np.stack([np.pad(run.speed, (0, longest - run.ticks)) for run in runs], axis=1) / per_motor
  volts = np.stack([np.pad(run.volts, (0, longest - run.ticks)) for run in runs], axis=1)
  steady = np.where(wish > 0, (line["P2"] * wish + 1.3 * line["P3"]) / line["P1"], volts)
  for applied in steady:
    current, volts_on = armature(car, applied, motor)
    loss += PERIOD * current**2 * car.motor_resistance
    charge += PERIOD * np.abs(current * volts_on) / 11.1
    motor = motor + PERIOD * (line["P1"] * applied - line["P2"] * motor - line["P3"] * np.tanh(motor / 3.0))
  return loss, charge


def _collect(draft: _Draft, log: Log, commands: np.ndarray) -> Session:
  """Cut a session's columns out of the log, add noise, round, and write down the truth."""
  spec, columns, ticks = draft.spec, draft.columns, len(draft.shaking)
  own = {name: values[:ticks, columns] for name, values in log.channels.items()}
  own["motor_speed"] = _late(own["motor_speed"], draft.sensors.speed_late)
  noisy = add_noise(own, log.vibration[:ticks, columns], spec.noise, stream(spec.seed, 6), draft.sensors.pose_noise)
  noisy |= {CHANNEL[draft.car.drivetrain.command]: commands[:ticks, 0], "steering_command": commands[:ticks, 1]}
  fine = log.fine[::5, :, columns]
  recordings, clean = [], {}
  for i, run in enumerate(draft.runs):
    kept = {name: values[: run.ticks, i] for name, values in noisy.items()}
    recordings.append(as_recording(run, kept, RESOLUTION, draft.sensors.every))
    clean[run.name] = fine[: run.ticks, :, i]
  return Session(
    tuple(recordings), draft.vehicle, draft.vehicle_std, _truth(draft, one_of(log.car, columns.start)), clean
  )


def _late(values: np.ndarray, late: float) -> np.ndarray:
  """A channel (T, n) as it was some seconds ago, linear between ticks, held before the start."""
  if late == 0.0:
    return values
  ticks = np.arange(len(values))
  return np.stack([np.interp(ticks - late / PERIOD, ticks, column) for column in values.T], axis=1)


def _truth(draft: _Draft, driven: Car) -> dict:
  """All that was hidden; `driven` is the car with what the effects changed in it."""
  spec = draft.spec
  effects = [
    {
      "id": effect.id,
      "size": effect.size,
      "subsystem": effect.subsystem,
      "in_catalogue": effect.catalogue,
      "unit": effect.unit,
      "parameters": effect.truth(),
    }
    for effect in draft.effects
  ]
  return {
    "seed": spec.seed,
    "design": spec.design,
    "noise": spec.noise,
    "sensors": draft.sensors.described(),
    "effects": effects,
    "car": describe(draft.car),
    "car_as_driven": describe(driven),
    "linearised": driven.linearised(),
    "gaps": gaps(draft.car),
    "signals": list(TRACE),
  }


def draw_effect(rng: np.random.Generator) -> tuple[str, float]:
  """One of the CLEAR effects, of about typical size and either sign where it has one."""
  name = str(rng.choice(CLEAR))
  sign = float(rng.choice([-1.0, 1.0])) if effect_class(name).signed else 1.0
  return name, sign * round(float(rng.uniform(0.85, 1.25)), 3)
