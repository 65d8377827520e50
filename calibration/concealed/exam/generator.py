"""What a published simulator has to offer to be driven through a laboratory session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

import numpy as np

from ..laboratory.manoeuvres import Manoeuvre
from .effects import Concealed, Effect, Nuisance

FINE = 10  # rows of the trace per control period
SIGNALS = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "accel_x", "accel_y", "motor", "road")


class MissingGenerator(ImportError):
  """The package of a generator is not installed."""


@dataclass(frozen=True)
class Start:
  """Pose [m, m, rad] and forward speed [m/s] at the beginning of a run."""

  x: float
  y: float
  yaw: float
  speed: float


class Plant(Protocol):
  """One car in one run. Signals in SI units and ISO 8855 axes, the order of SIGNALS."""

  def start(self, start: Start) -> np.ndarray:
    """Put the car there, rolling straight; the signals (10,) of that instant."""
    ...

  def advance(self, drive: float, steer: float) -> np.ndarray:
    """One control period under a drive command and a steering angle [rad]; signals (FINE, 10) at its fine steps."""
    ...


class Generator(Protocol):
  """One car of a published simulator.

  Attributes:
    design: of the session it is driven through.
    drive_limit, drive_step: of its drive command, in the unit of `channel`.
    noise: root mean square of each sensor, by the keys of `sensing.NOISE`.
    driver: who drives it; takes what the laboratory's `Driver` takes, one run at a time.
    effects: what its own parameters conceal.
  """

  design: str
  drive_limit: float
  drive_step: float
  channel: str
  noise: Mapping[str, float]
  driver: type[Any]
  effects: dict[str, Effect]

  def __init__(self, rng: np.random.Generator) -> None:
    """A drawn car. Raises MissingGenerator where its package is not installed."""
    ...

  def runs(self, rng: np.random.Generator) -> list[Manoeuvre]:
    """The manoeuvres of a session in order."""
    ...

  def plant(
    self, concealed: Sequence[Concealed] = (), moved: Sequence[tuple[Nuisance, float]] = (), later: bool = False
  ) -> Plant:
    """A fresh car for one run, with effects on its parameters and with other numbers.

    `later`: in the second half of a session.

    Raises ValueError where such a car is impossible.
    """
    ...

  def bench(self, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """What a careful owner also states of the car before the effect, as keys of [vehicle], and its deviations."""
    ...

  def nuisances(self, std: Mapping[str, float]) -> dict[str, Nuisance]:
    """Numbers that an explanation of the log may move; `std` of what the owner states."""
    ...

  def measured(self, rng: np.random.Generator) -> tuple[dict[str, float | str], dict[str, float]]:
    """The [vehicle] table as an owner would measure it, and its standard deviations."""
    ...

  def drive_line(self) -> tuple[float, float, float]:
    """Drive command per m/s of steady speed, command that just keeps the car moving, command per m/s of error."""
    ...

  def described(self) -> dict[str, float | str]:
    """Every number of the car, for the truth."""
    ...


def load_package(name: str, package: str) -> Any:
  """A generator's module. Raises MissingGenerator with the cure where it is not installed."""
  try:
    return import_module(name)
  except ImportError as error:
    raise MissingGenerator(f"{package} is not installed: pip install 'qcar-twin[exam]'") from error
