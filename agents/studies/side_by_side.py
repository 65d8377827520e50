"""Several drives whose cars are one simulation, stepped at once.

Drives that differ in path or filter cannot be one drive. A simulation made of array operations costs little more for
six hundred cars than for sixty, so each drive runs in a thread of its own, up to where it needs its cars' next signals,
and waits there for the others.
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from agents.control.interface import Body
from qcar_twin.plant import COMMANDS, Simulation

Array = NDArray[np.float64]
Result = TypeVar("Result")


def side_by_side(plant: Body, drives: Sequence[Callable[[Any], Result]]) -> list[Result]:
  """What each drive returns, in their order.

  Args:
    plant: any, whose cars do not touch each other.
    drives: each is given a body of the period of `plant`, begins cars on it once and steps them. Cars
      of a drive that has returned stand still.

  Raises:
    Whatever a drive, or the simulation, raises first.
  """
  table = _Table(plant, len(drives))
  with ThreadPoolExecutor(max(len(drives), 1)) as pool:
    running = [pool.submit(_seated, drive, table, seat) for seat, drive in enumerate(drives)]
  errors = [error for future in running if (error := future.exception()) is not None]
  if errors:
    raise table.error or errors[0]
  return [future.result() for future in running]


def _seated(drive: Callable[[Any], Result], table: "_Table", seat: int) -> Result:
  """A drive in its thread."""
  try:
    return drive(_Seat(table, seat))
  except BaseException as error:
    table.fail(error)
    raise
  finally:
    table.leave(seat)


class _Table:
  """Where drives wait for each other: the simulation goes on when all that are still there have asked."""

  def __init__(self, plant: Body, seats: int):
    self.plant = plant
    self.error: BaseException | None = None
    self._here, self._asked, self._rounds = set(range(seats)), dict[int, Any](), 0
    self._turn = threading.Condition()
    self._simulation: Simulation | None = None
    self._cars: dict[int, slice] = {}

  def ask(self, seat: int, what: Any) -> Array:
    """Hand in starts with their parameters, or commands; signals of the seat's cars after them."""
    with self._turn:
      if self.error is None:
        self._asked[seat], now = what, self._rounds
        self._go_on()
        self._turn.wait_for(lambda: self._rounds > now or self.error is not None)
      if self.error is not None:
        raise RuntimeError("another drive, or the simulation, has stopped") from self.error
      assert self._simulation is not None
      return self._simulation.signals[self._cars[seat]].copy()

  def leave(self, seat: int) -> None:
    """Be waited for no longer."""
    with self._turn:
      self._here.discard(seat)
      if self._asked and self.error is None:
        self._go_on()

  def fail(self, error: BaseException) -> None:
    """Let everybody stop; the first error counts."""
    with self._turn:
      self.error = self.error or error
      self._turn.notify_all()

  def _go_on(self) -> None:
    """A period, once all have asked."""
    if len(self._asked) < len(self._here):
      return
    try:
      self._begin() if self._simulation is None else self._step(self._simulation)
    except BaseException as error:
      self.fail(error)
      raise
    self._asked.clear()
    self._rounds += 1
    self._turn.notify_all()

  def _begin(self) -> None:
    seats = sorted(self._asked)
    ends = np.cumsum([0, *(len(self._asked[seat][1]) for seat in seats)]).tolist()
    self._cars = {seat: slice(ends[k], ends[k + 1]) for k, seat in enumerate(seats)}
    theta, start = (np.concatenate([self._asked[seat][part] for seat in seats]) for part in (0, 1))
    self._simulation = self.plant.begin(theta, start)

  def _step(self, simulation: Simulation) -> None:
    commands = np.zeros((len(simulation.signals), len(COMMANDS)))
    for seat, wanted in self._asked.items():
      commands[self._cars[seat]] = wanted
    simulation.step(commands)


class _Seat:
  """The plant as one of the drives sees it."""

  def __init__(self, table: _Table, seat: int):
    self.period = table.plant.period
    self._table, self._seat = table, seat

  def begin(self, theta: Array, start: Array) -> "_Cars":
    """The drive's cars among those of all; parameters (N, P), starts (N, 7)."""
    return _Cars(self._table, self._seat, (theta, start))


class _Cars:
  """A drive's cars. `signals`: (N, 10)."""

  def __init__(self, table: _Table, seat: int, begun: tuple[Array, Array]):
    self._table, self._seat = table, seat
    self.signals = table.ask(seat, begun)

  def step(self, commands: Array) -> Array:
    """Hold commands (N, 2) for one period; the signals after it."""
    self.signals = self._table.ask(self._seat, np.array(commands))
    return self.signals
