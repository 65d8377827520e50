"""A mechanism in the simulations where it is present, and its view of their quantities."""

import dataclasses
import difflib

import numpy as np

from qcar_twin.twin.engines import Array, Rows
from qcar_twin.twin.mechanisms.base import Mechanism, State
from qcar_twin.twin.mechanisms.by_motion import Resisting, Weakening

STEPPED = ("command", "actuator", "force", "contact")  # stages that act while cars are under way
_COLUMNS = {"drive": frozenset((0,)), "steering": frozenset((1,))}  # commands that a subsystem changes; both by default


def under_way(mechanism: Mechanism) -> bool:
  """Whether it has to do with how cars move: a sensor's error has where it is an error of the car's own size, too."""
  return mechanism.stage in STEPPED or type(mechanism).write_model is not Mechanism.write_model


def moves_start(mechanism: Mechanism, by_pose: bool = True) -> bool:
  """Whether cars begin elsewhere than their sensors show because of it. `by_pose`: some were read off the pose."""
  kind = type(mechanism)
  says = kind.begin is not Mechanism.begin or kind.own_share is not Mechanism.own_share
  return says and (by_pose or not mechanism.of_pose)


@dataclasses.dataclass(eq=False)
class Slot:
  """A mechanism, the rows where it is present and its parameters there, (n, p)."""

  mechanism: Mechanism
  rows: Rows
  theta: Array
  state: State = dataclasses.field(default_factory=dict)
  touched: set[str] = dataclasses.field(default_factory=set)  # quantities it has changed so far

  def __post_init__(self) -> None:
    kind = type(self.mechanism)
    self.commands = kind.command is not Mechanism.command and not self.mechanism.passes(self.theta).all()
    self.pushes = kind.wrench is not Mechanism.wrench
    self.writes = kind.write_model is not Mechanism.write_model

  def place(self, row: int) -> int | None:
    """Where one simulation's row is among this slot's; None where the mechanism is absent from it."""
    if isinstance(self.rows, slice):
      first, end = self.rows.start or 0, self.rows.stop
      return row - first if row >= first and (end is None or row < end) else None
    there = np.flatnonzero(self.rows == row)
    return int(there[0]) if len(there) else None

  def state_in(self, rows: Rows, count: int) -> State:
    """Hidden state in other rows of `count` simulations, zeros where the mechanism was absent."""
    moved = {}
    for name, values in self.state.items():
      everywhere = np.zeros((count, *values.shape[1:]), values.dtype)
      everywhere[self.rows] = values
      moved[name] = everywhere[rows].copy()
    return moved

  def adopt(self, row: int, other: "Slot") -> None:
    """Hidden state of one simulation, from the same mechanism's slot where that simulation is alone."""
    mine = self.place(row)
    for name, values in other.state.items() if mine is not None else ():
      if name not in self.state:
        self.state[name] = np.zeros((len(self.theta), *values.shape[1:]), values.dtype)
      self.state[name][mine] = values[0]

  def held_back(self, before: Array, period: float) -> Array:
    """Commands before a segment, (N, K, 2), with this slot's as it leaves them."""
    if type(self.mechanism).past is Mechanism.past:
      return before
    out = before.copy()
    out[self.rows] = self.mechanism.past(self.theta, before[self.rows], period)
    return out

  @property
  def acts(self) -> bool:
    """Whether it has something to do in every control period."""
    return self.commands or self.pushes or self.mechanism.varies

  @property
  def foreseen(self) -> bool:
    """Whether what it does is known before the car is simulated."""
    return self.mechanism.open_loop and not self.pushes and not self.mechanism.varies

  @property
  def by_motion(self) -> bool:
    """Whether an engine knows the form of all that it does while cars are under way."""
    return isinstance(self.mechanism, Resisting | Weakening)

  @property
  def columns(self) -> frozenset[int]:
    """Of the commands, those that it changes."""
    return _COLUMNS.get(self.mechanism.subsystem, frozenset((0, 1))) if self.commands else frozenset()


class QuantityView:
  """`Model` of qcar_twin.twin.mechanisms.base: the quantities of some rows, open to one mechanism."""

  def __init__(self, values: dict[str, Array], rows: Rows):
    self._values, self._rows = values, rows
    self.changed: set[str] = set()

  def get(self, quantity: str) -> Array:
    return self._column(quantity)[self._rows].copy()

  def set(self, quantity: str, value: Array) -> None:
    self._column(quantity)[self._rows] = value
    self.changed.add(quantity)

  def _column(self, quantity: str) -> Array:
    if quantity not in self._values:
      near = difflib.get_close_matches(quantity, self._values, n=3) or sorted(self._values)
      raise KeyError(f"no quantity '{quantity}' in the simulator; did you mean {', '.join(near)}?")
    return self._values[quantity]


class Recorder(QuantityView):
  """A view that remembers the fitted value of whatever is changed first."""

  def __init__(self, values: dict[str, Array], rows: Rows, untouched: dict[str, Array]):
    super().__init__(values, rows)
    self._before = untouched

  def set(self, quantity: str, value: Array) -> None:
    if quantity not in self._before:
      self._before[quantity] = self._column(quantity).copy()
    super().set(quantity, value)
