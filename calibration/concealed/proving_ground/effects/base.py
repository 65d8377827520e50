"""A concealed effect: one small class, vectorised over the columns (cars) that it sits on, found by its id."""

from __future__ import annotations

import difflib
from types import SimpleNamespace
from typing import ClassVar

import numpy as np

from ..sensing import Log
from ..simulation import Simulation

EFFECTS: dict[str, type[Effect]] = {}


class Effect:
  """Base of every effect. `size` is in multiples of the typical magnitude; hooks do nothing unless a subclass does.

  Class attributes: `id` (canonical name), `subsystem`, `parameter` (name of the quantity), `typical` (its magnitude at
  size 1), `unit`, `signed` (a negative size means the other direction), `catalogue` (False: physics that the diagnosis
  has no name for), `wild` (True: of wild sessions only).
  """

  id: ClassVar[str] = ""
  subsystem: ClassVar[str]
  parameter: ClassVar[str]
  typical: ClassVar[float]
  unit: ClassVar[str]
  signed: ClassVar[bool] = False
  catalogue: ClassVar[bool] = True
  wild: ClassVar[bool] = False

  def __init__(self, size: float, columns: slice, rng: np.random.Generator) -> None:
    """`columns`: the cars (recordings) it acts on; `rng`: for what the size does not fix (a place, a heading)."""
    if size < 0 and not self.signed:
      raise ValueError(f"effect '{self.id}' has no negative size, got {size:g}")
    self.size, self.columns, self.rng = float(size), columns, rng
    self.value = self.typical * self.size
    self.choose(rng)

  def __init_subclass__(cls) -> None:
    if cls.id:
      EFFECTS[cls.id] = cls

  def choose(self, rng: np.random.Generator) -> None:
    """Draw what the size does not fix."""

  def prepare(self, car: SimpleNamespace) -> None:
    """Change the car's columns before anything is built from them."""

  def begin(self, sim: Simulation) -> None:
    """Lay out memory, once, when the cars stand at their start."""

  def act(self, sim: Simulation) -> None:
    """Each fine step: change sim.command[:, columns] (V, rad at the servo), grip, resistance, gravity, …"""

  def link(self, sim: Simulation) -> None:
    """Each fine step: change sim.road[columns], the mean road-wheel angle [rad] that the servo's angle makes."""

  def load(self, sim: Simulation) -> None:
    """Each derivative: add to wrench (3, N) [N, N, N m], wheel_torque (4, N), motor_torque (N,) [N m]."""

  def contact(self, sim: Simulation) -> None:
    """Each derivative: change the tyre forces sim.dynamics.force (2, 4, N) [N]."""

  def sense(self, log: Log) -> None:
    """After the drive: change the log's noise-free channels at [:, columns]."""

  def truth(self) -> dict[str, float]:
    """What was hidden: the canonical quantity, and whatever was drawn."""
    return {self.parameter: self.value}

  def implements(self, hook: str) -> bool:
    return getattr(type(self), hook) is not getattr(Effect, hook)


def effect_class(name: str) -> type[Effect]:
  """The effect of an id; KeyError names the nearest one."""
  if name not in EFFECTS:
    near = difflib.get_close_matches(name, EFFECTS, n=1)
    raise KeyError(
      f"no effect '{name}'; " + (f"did you mean '{near[0]}'?" if near else f"valid are: {', '.join(sorted(EFFECTS))}")
    )
  return EFFECTS[name]


def towards(value: np.ndarray, goal: np.ndarray, h: float, memory: float) -> np.ndarray:
  """Exact relaxation of value to goal over h seconds with time constant memory [s]."""
  return goal + (value - goal) * np.exp(-h / memory)
