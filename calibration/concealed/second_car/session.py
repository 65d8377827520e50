"""Sessions of the second car: manoeuvres and concealed effects in; recordings, vehicle table and truth out."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np

from ..laboratory.designs import plan
from ..laboratory.driver import BELIEFS, Driver, coloured, hands
from ..laboratory.manoeuvres import Manoeuvre
from ..laboratory.written import Session, as_recording, stream
from .car import SecondCar
from .effects import conceal
from .floor import Floor
from .sensing import DECIMALS, POSE_EVERY, sense
from .simulation import FINE, SIGNALS, TOLERANCE, Simulation, columns

Push = Callable[[Simulation], np.ndarray]
Misread = Callable[[dict[str, np.ndarray]], None]

DESIGNS = ("compact", "lab", "paper")
LARGEST, STEP = 4.0, 1e-3  # V: largest command and its resolution
DRAUGHT = ((0.04, 0.05, 0.003), 0.2)  # N, N, N m rms on the body; s memory
MOVING = 0.1  # m/s from which the body feels them whole


def make_second_session(
  seed: int,
  effects: tuple[tuple[str, float], ...] = (),
  design: str = "compact",
  noise: float = 1.0,
  car: SecondCar | None = None,
  tolerance: float = TOLERANCE,
  push: Push | None = None,
  misread: Misread | None = None,
) -> Session:
  """One session, the same bit for bit for the same arguments.

  Args:
    effects: (id, size in multiples of the typical one); those of size 0 are left out.
    design: one of DESIGNS.
    noise: factor on all that is random in sensors, floor and draught.
    car: drawn from the seed where not given.
    tolerance: of the integrator.
    push: one more force and yaw moment on the body, (3, n) [N, N, N m], of the simulation as it stands; held for a
      control period, as the draught is.
    misread: errors of the sensors, put into the channels (T, n).

  Raises:
    KeyError: an effect that the second car does not have, or a design that is not for it.
  """
  if design not in DESIGNS:
    raise KeyError(f"the second car does not drive the design '{design}'; valid are: {', '.join(DESIGNS)}")
  bare = car or drawn_car(seed)
  vehicle, std = bare.measured(stream(seed, 1))
  runs = plan(design, stream(seed, 2))
  driven, concealed = conceal(bare, tuple((name, size) for name, size in effects if size != 0.0), stream(seed, 100))
  table = columns(driven, len(runs), bare.mass)
  table.warm = _warm(bare, len(runs), stream(seed, 8))
  simulation, commands = _drive(seed, runs, table, _beliefs(bare, vehicle, stream(seed, 5)), noise, tolerance, push)
  channels = sense(table, simulation.trace, noise, stream(seed, 6))
  if misread:
    misread(channels)
  channels |= {"motor_voltage": commands[:, 0], "steering_command": commands[:, 1]}
  every = {name: POSE_EVERY for name in DECIMALS if name.startswith("pose")}
  recordings = tuple(
    as_recording(run, {name: values[: run.ticks, i] for name, values in channels.items()}, DECIMALS, every)
    for i, run in enumerate(runs)
  )
  clean = {run.name: simulation.trace[:-1:FINE][: run.ticks, :, i] for i, run in enumerate(runs)}
  truth = {"seed": seed, "design": design, "noise": noise, "effects": concealed, "car": bare.described(),
           "car_as_driven": driven.described(), "signals": list(SIGNALS)}  # fmt: skip
  return Session(recordings, vehicle, std, truth, clean, "calibration/concealed/second_car")


def drawn_car(seed: int) -> SecondCar:
  """The car of a seed's session, before any effect."""
  return SecondCar.draw(stream(seed, 0))


def _drive(
  seed: int,
  runs: list[Manoeuvre],
  car: SimpleNamespace,
  beliefs: SimpleNamespace,
  noise: float,
  tolerance: float,
  push: Push | None = None,
) -> tuple[Simulation, np.ndarray]:
  """All runs side by side to the end of the longest, with the commands given (T, 2, n)."""
  shaking = hands(stream(seed, 3), runs)
  ticks, n = len(shaking), len(runs)
  driver = Driver(runs, shaking, beliefs)
  size, memory = DRAUGHT
  draught = noise * coloured(stream(seed, 4), (ticks, 3, n), memory) * np.array(size)[:, None]
  start = _starts(runs, car)
  x, y, yaw, speed = start[:, :4].T
  command = driver.commands(0, x, y, yaw, speed / (car.wheel_radius * car.gear_ratio))
  simulation = Simulation(car, Floor(stream(seed, 7), noise), start, command, ticks, stream(seed, 9), tolerance)
  commands = np.empty((ticks, 2, n))
  for tick in range(ticks):
    state = simulation.state
    if tick > 0:
      command = driver.commands(tick, state.x, state.y, state.yaw, state.motor)
    commands[tick] = command
    wind = draught[tick] * np.minimum(np.abs(state.u) / MOVING, 1.0)
    simulation.advance(command, wind + push(simulation) if push else wind)
  return simulation, commands


def _starts(runs: list[Manoeuvre], car: SimpleNamespace) -> np.ndarray:
  """Starts (n, 7): already in the turn that the first steering angle asks for, if rolling."""
  x, y, yaw, speed = np.array([run.start for run in runs]).T
  angle = np.where(speed > 0.0, [run.steer[0] for run in runs], 0.0)
  turning = speed * np.tan(angle) / (car.cg_to_front + car.cg_to_rear)
  return np.stack([x, y, yaw, speed, turning * car.cg_to_rear, turning, angle], axis=1)


def _beliefs(car: SecondCar, vehicle: dict[str, float | str], rng: np.random.Generator) -> SimpleNamespace:
  """What the driver reckons with: the measured geometry and a feel for the drive that is a few per cent off."""
  per_motor = float(vehicle["gear_ratio"]) * float(vehicle["wheel_radius"])
  per_speed, to_move = np.array(car.drive_line()) * (1.0 + 0.03 * rng.standard_normal(2))
  base = float(vehicle["cg_to_front"]) + float(vehicle["cg_to_rear"])
  values = (base, per_motor, per_speed / per_motor, to_move, car.max_steering, 1.0, 1.0, LARGEST, STEP)
  return SimpleNamespace(**dict(zip(BELIEFS, values, strict=True)))


def _warm(car: SecondCar, n: int, rng: np.random.Generator) -> np.ndarray:
  """Factor on the winding's resistance in each run: copper, 0.0039 / K, warms over the session."""
  risen = car.winding_warmth * -np.expm1(-np.arange(n) / 5.0)
  return 1.0 + 0.0039 * (risen + 0.5 * rng.standard_normal(n))
