"""Somebody else's cars in the place of the twin's engine: the twin's effects and sensors can act around them."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.plant import signal_index
from qcar_twin.twin.engines import ByMotion, Rows

Array = NDArray[np.float64]
_MOTION = slice(0, 6)  # of the signals: pose, velocity, yaw rate
_SENSED = [signal_index(name) for name in ("yaw_rate", "accel_x", "accel_y", "motor_speed", "steering_angle")]


class CarModel(Protocol):
  """A car with a step of 10 ms; a module will do."""

  def at_start(self, car: Any, start: Array, command: Array) -> Array: ...
  def motion(self, x: Array) -> Array: ...
  def step(self, x: Array, u: Array, car: Any) -> tuple[Array, Array]: ...


class ModelCars:
  """N cars of a model behind `qcar_twin.twin.engines.Engine`.

  Quantities of the simulator change nothing here: effects that write them cannot act around the model.

  Args:
    model, car: the model and its numbers; None for cars that only hold the quantities that are written.
    size: N.
  """

  def __init__(self, model: CarModel | None, car: Mapping[str, Any] | None, size: int):
    self._model, self._car, self._size = model, car, size
    self._state: Array | None = None
    self.values: dict[str, Array] = {}

  def load(self, values: dict[str, Array]) -> None:
    self.values = values

  def write(self, changed: set[str], rows: Rows) -> None:
    """Nothing follows quantities here."""

  def commit(self) -> None:
    """Nor is anything derived from them."""

  def place(self, start: Array, turning: Array, signals: Array) -> None:
    signals[:] = 0.0
    signals[:, _MOTION], signals[:, signal_index("steering_angle")] = start[:, :6], start[:, 6]
    if self._model is not None:
      self._state = None
      self._start = start.copy()
      signals[:, signal_index("motor_speed")] = start[:, 3] / self._car["travel_per_radian"]  # type: ignore[index]

  def adopt(self, row: int, other: Any) -> None:
    raise TypeError("cars of an export are not swapped one by one")

  def push(self, force: Array, signals: Array) -> None:
    raise TypeError("an export takes no force from outside; leave effects of stage 'force' to the twin")

  def hold(self, rows: Rows, drive: Array) -> None:
    """Nothing: dead times are in the exported file's own lines of commands."""

  def advance(self, commands: Array, running: NDArray[np.intp] | None, signals: Array) -> None:
    assert self._model is not None
    if self._state is None:
      self._state = self._model.at_start(self._car, self._start, commands)
    state, sensed = self._model.step(self._state, commands, self._car)
    rows = np.arange(self._size) if running is None else running
    self._state[rows] = state[rows]
    signals[rows, _MOTION] = self._model.motion(state)[rows]
    signals[rows[:, None], _SENSED] = sensed[rows]

  def run(self, commands: Array, periods: NDArray[np.int64], signals: Array, by_motion: ByMotion) -> bool:
    return False
