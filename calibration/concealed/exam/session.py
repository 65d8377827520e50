"""A session of an exam's car: a seed and what is concealed in; recordings, vehicle table and truth out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from ..laboratory.driver import BELIEFS, hands
from ..laboratory.manoeuvres import Manoeuvre
from ..laboratory.written import Session, as_recording, stream
from .commonroad.car import CommonroadCar, CommonroadFullCar
from .effects import Concealed, Nuisance, Signals, of_kind
from .exudyn.car import ExudynCar
from .generator import FINE, SIGNALS, Generator, Start
from .sensing import DECIMALS, POSE_EVERY, as_signals, sense, session_bias
from .slipx_car import SlipxCar

GENERATORS: dict[str, type[Generator]] = {
  "slipx": SlipxCar, "commonroad": CommonroadCar, "commonroad_full": CommonroadFullCar, "exudyn": ExudynCar
}  # fmt: skip


@dataclass(frozen=True)
class Setting:
  """All of a session but its driving: the car, what its owner states, the runs and the driver."""

  car: Generator
  vehicle: dict[str, float | str]
  std: dict[str, float]
  runs: list[Manoeuvre]
  shaking: np.ndarray
  beliefs: SimpleNamespace


def set_up(generator: str, seed: int, bench: bool = False) -> Setting:
  """The setting that a seed decides.

  Args:
    generator: a name of GENERATORS.
    bench: whether the owner states what a bench showed, too.

  Raises:
    KeyError: no such generator.
    MissingGenerator: its package is not installed.
  """
  if generator not in GENERATORS:
    raise KeyError(f"no generator '{generator}'; valid are: {', '.join(GENERATORS)}")
  car = GENERATORS[generator](stream(seed, 0))
  vehicle, std = car.measured(stream(seed, 1))
  if bench:
    stated, deviations = car.bench(stream(seed, 7))
    vehicle, std = vehicle | stated, std | deviations
  runs = car.runs(stream(seed, 2))
  return Setting(car, vehicle, std, runs, hands(stream(seed, 3), runs), _beliefs(car, vehicle, stream(seed, 4)))


def make_exam_session(
  generator: str, seed: int, noise: float = 1.0, concealed: Sequence[Concealed] = (), bench: bool = False
) -> Session:
  """One session, the same bit for bit for the same arguments; those of `set_up`, and:

  Args:
    noise: factor on all that is random in the sensors.
    concealed: effects that act during the session; the owner measured the car before.
  """
  setting = set_up(generator, seed, bench)
  car, runs = setting.car, setting.runs
  bias, rng = session_bias(stream(seed, 5)), stream(seed, 6)
  recordings, clean = [], {}
  for i, run in enumerate(runs):
    trace, commands = _drive(car, run, setting.shaking[: run.ticks, :, i : i + 1], setting.beliefs, concealed)
    channels = sense(observed(trace, concealed), bias, noise, rng, car.noise)
    channels |= {car.channel: commands[:, 0], "steering_command": commands[:, 1]}
    every = {name: POSE_EVERY for name in DECIMALS if name.startswith("pose")}
    recordings.append(as_recording(run, channels, DECIMALS, every))
    clean[run.name] = trace[:-1:FINE]
  effects = [{"id": c.name, "size": c.size, "unit": c.effect.unit, "right": c.effect.answers} for c in concealed]
  truth = {"seed": seed, "design": car.design, "noise": noise, "effects": effects, "car": car.described(),
           "signals": list(SIGNALS)}  # fmt: skip
  return Session(tuple(recordings), setting.vehicle, setting.std, truth, clean, "calibration/concealed/exam")


class Commanded:
  """A car in one run, behind whatever changes its commands on the way."""

  def __init__(
    self, car: Generator, run: Manoeuvre, concealed: Sequence[Concealed], moved: Sequence[tuple[Nuisance, float]] = ()
  ) -> None:
    self.plant = car.plant(of_kind(concealed, "parameter"), moved, run.session == "afternoon")
    self.filters = [c.effect.act(c.size, car.drive_limit) for c in of_kind(concealed, "command")]
    self.first = self.plant.start(Start(*run.start))

  def advance(self, drive: float, steer: float) -> np.ndarray:
    """One control period under logged commands; signals (FINE, 10)."""
    for change in self.filters:
      drive, steer = change(drive, steer)
    return self.plant.advance(drive, steer)


def replayed(
  car: Generator, run: Manoeuvre, commands: np.ndarray, concealed: Sequence[Concealed] = (),
  moved: Sequence[tuple[Nuisance, float]] = (),
) -> np.ndarray:  # fmt: skip
  """Trace (FINE T + 1, 10) under given commands (T, 2): nobody answers to what the car does."""
  plant = Commanded(car, run, concealed, moved)
  rows = [plant.first[None], *(plant.advance(drive, steer) for drive, steer in commands)]
  return _unwrapped(np.concatenate(rows))


def driven(setting: Setting, concealed: Sequence[Concealed] = ()) -> list[np.ndarray]:
  """Commands (T, 2) of every run as the driver gives them."""
  return [
    _drive(setting.car, run, setting.shaking[: run.ticks, :, i : i + 1], setting.beliefs, concealed)[1]
    for i, run in enumerate(setting.runs)
  ]


def observed(trace: np.ndarray, concealed: Sequence[Concealed]) -> Signals:
  """What the sensors see of a trace."""
  signals = as_signals(trace)
  for one in of_kind(concealed, "sensor"):
    signals = one.effect.act(signals, one.size)
  return signals


def _drive(
  car: Generator, run: Manoeuvre, shaking: np.ndarray, beliefs: SimpleNamespace, concealed: Sequence[Concealed]
) -> tuple[np.ndarray, np.ndarray]:
  """Trace (FINE T + 1, 10) of a run and its commands (T, 2)."""
  plant, driver = Commanded(car, run, concealed), car.driver([run], shaking, beliefs)
  rows, commands = [plant.first[None]], np.empty((run.ticks, 2))
  for tick in range(run.ticks):
    now = dict(zip(SIGNALS, rows[-1][-1], strict=True))
    told = driver.commands(tick, *(np.array([now[name]]) for name in ("x", "y", "yaw", "motor")))
    commands[tick] = told[:, 0]
    rows.append(plant.advance(*commands[tick]))
  return _unwrapped(np.concatenate(rows)), commands


def _unwrapped(trace: np.ndarray) -> np.ndarray:
  trace[:, 2] = np.unwrap(trace[:, 2])
  return trace


def _beliefs(car: Generator, vehicle: dict[str, float | str], rng: np.random.Generator) -> SimpleNamespace:
  """What the driver reckons with: the measured geometry and a feel for the drive that is a few per cent off."""
  per_speed, to_move, answer = car.drive_line()
  feel = 1.0 + 0.03 * rng.standard_normal(2)
  base = float(vehicle["cg_to_front"]) + float(vehicle["cg_to_rear"])
  per_motor = float(vehicle["gear_ratio"]) * float(vehicle["wheel_radius"])
  values = (base, per_motor, per_speed * feel[0], to_move * feel[1], float(vehicle["max_steering"]), answer, answer,
            car.drive_limit, car.drive_step)  # fmt: skip
  return SimpleNamespace(**dict(zip(BELIEFS, values, strict=True)))
