"""What moves a twin's cars: MuJoCo, or the reduced car that stands in for it while a fit searches.

A simulation places its cars, writes quantities, advances and reads through `Engine`; neither it nor any mechanism knows
which one carries it.
"""

import dataclasses
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = slice | NDArray[np.int64]
EngineKind = Literal["mujoco", "reduced"]
ENGINES: tuple[EngineKind, ...] = get_args(EngineKind)


@dataclasses.dataclass(frozen=True)
class ByMotion:
  """What goes by how cars move and needs nobody to be asked, in the cars of a run; each array in one piece of memory.

  Attributes:
    drag: F = -drag |v| v on the bodies at their CG, in the plane, v of each period's beginning, kg/m, (N,).
    weakened: shares m and f of motors, (T, N, 2): of a drive command u and the back-EMF e of the period's beginning
      e + (u - e m) m f acts; None for motors that stay as they are.
  """

  drag: Array
  weakened: Array | None


class Engine(Protocol):
  """N cars.

  Attributes:
    values: the quantities of `Model` in twin/mechanisms/base.py and those of the base parameters, (N,) or (N, 4); who
      changes one says so to `write`.
  """

  @property
  def values(self) -> dict[str, Array]: ...

  def load(self, values: dict[str, Array]) -> None:
    """Take base values of every quantity, and write all of them."""
    ...

  def write(self, changed: set[str], rows: Rows) -> None:
    """Bring some cars in line with their quantities."""
    ...

  def commit(self) -> None:
    """What derives from masses follows them; called after the first mechanisms have written."""
    ...

  def place(self, start: Array, turning: Array, signals: Array) -> None:
    """Put the cars to states (N, 7), in the order of START, and write the signals there, (N, 10).

    Args:
      turning: speeds of the wheels and the motor, rad/s, (N, 5).
    """
    ...

  def adopt(self, row: int, other: Any) -> None:
    """Put one car into the state of the only car of another engine of the same kind; its quantities stay."""
    ...

  def push(self, force: Array, signals: Array) -> None:
    """Force on the bodies at their CG until further notice, (N, 3): x, y [N], moment [N m], body frame."""
    ...

  def hold(self, rows: Rows, drive: Array) -> None:
    """What motors still get for their `drive_hold`: of the drive's commands of the two periods before, (n, 2)."""
    ...

  def advance(self, commands: Array, running: NDArray[np.intp] | None, signals: Array) -> None:
    """Hold commands (N, 2) for one control period, and write the signals after it; cars that are not running stay."""
    ...

  def run(self, commands: Array, periods: NDArray[np.int64], signals: Array, by_motion: ByMotion) -> bool:
    """Hold commands (T, N, 2), a period each, for so many periods of every car, (N,), with nothing else to do between.

    Args:
      signals: (N, T + 1, 10), row 0 given; a car that has driven its periods keeps its last row.
      by_motion: what is done besides.

    Returns:
      False, and nothing done, where the engine goes period by period only.
    """
    ...
