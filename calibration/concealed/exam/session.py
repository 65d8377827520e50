"""A session of an exam's car: a seed in; recordings, vehicle table and truth out."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np

from ..laboratory.designs import plan
from ..laboratory.driver import BELIEFS, Driver, hands
from ..laboratory.manoeuvres import Manoeuvre
from ..laboratory.written import Session, as_recording, stream
from .generator import FINE, SIGNALS, Generator, Start
from .sensing import DECIMALS, POSE_EVERY, sense, session_bias
from .slipx_car import SlipxCar

GENERATORS: dict[str, Callable[[np.random.Generator], Generator]] = {"slipx": SlipxCar}


def make_exam_session(generator: str, seed: int, noise: float = 1.0) -> Session:
  """One session without a concealed effect, the same bit for bit for the same arguments.

  Args:
    generator: a name of GENERATORS.
    noise: factor on all that is random in the sensors.

  Raises:
    KeyError: no such generator.
    MissingGenerator: its package is not installed.
  """
  if generator not in GENERATORS:
    raise KeyError(f"no generator '{generator}'; valid are: {', '.join(GENERATORS)}")
  car = GENERATORS[generator](stream(seed, 0))
  vehicle, std = car.measured(stream(seed, 1))
  runs = plan(car.design, stream(seed, 2))
  shaking, beliefs = hands(stream(seed, 3), runs), _beliefs(car, vehicle, stream(seed, 4))
  bias, rng = session_bias(stream(seed, 5)), stream(seed, 6)
  recordings, clean = [], {}
  for i, run in enumerate(runs):
    trace, commands = _drive(car, run, shaking[: run.ticks, :, i : i + 1], beliefs)
    channels = sense(trace, bias, noise, rng) | {car.channel: commands[:, 0], "steering_command": commands[:, 1]}
    every = {name: POSE_EVERY for name in DECIMALS if name.startswith("pose")}
    recordings.append(as_recording(run, channels, DECIMALS, every))
    clean[run.name] = trace[:-1:FINE]
  truth = {"seed": seed, "design": car.design, "noise": noise, "effects": [], "car": car.described(),
           "signals": list(SIGNALS)}  # fmt: skip
  return Session(tuple(recordings), vehicle, std, truth, clean, "calibration/concealed/exam")


def _drive(
  car: Generator, run: Manoeuvre, shaking: np.ndarray, beliefs: SimpleNamespace
) -> tuple[np.ndarray, np.ndarray]:
  """Trace (FINE T + 1, 10) of a run and its commands (T, 2)."""
  plant, driver = car.plant(), Driver([run], shaking, beliefs)
  rows, commands = [plant.start(Start(*run.start))[None]], np.empty((run.ticks, 2))
  for tick in range(run.ticks):
    now = dict(zip(SIGNALS, rows[-1][-1], strict=True))
    told = driver.commands(tick, *(np.array([now[name]]) for name in ("x", "y", "yaw", "motor")))
    commands[tick] = told[:, 0]
    rows.append(plant.advance(*commands[tick]))
  trace = np.concatenate(rows)
  trace[:, 2] = np.unwrap(trace[:, 2])
  return trace, commands


def _beliefs(car: Generator, vehicle: dict[str, float | str], rng: np.random.Generator) -> SimpleNamespace:
  """What the driver reckons with: the measured geometry and a feel for the drive that is a few per cent off."""
  per_speed, to_move, answer = car.drive_line()
  feel = 1.0 + 0.03 * rng.standard_normal(2)
  base = float(vehicle["cg_to_front"]) + float(vehicle["cg_to_rear"])
  per_motor = float(vehicle["gear_ratio"]) * float(vehicle["wheel_radius"])
  values = (base, per_motor, per_speed * feel[0], to_move * feel[1], float(vehicle["max_steering"]), answer, answer,
            car.drive_limit, car.drive_step)  # fmt: skip
  return SimpleNamespace(**dict(zip(BELIEFS, values, strict=True)))
