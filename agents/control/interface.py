"""What a path-tracking controller sees and what it must do."""

import dataclasses
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.paths import Errors, Path
from qcar_twin.plant import Simulation
from qcar_twin.recent import Recent

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Situation:
  """N cars at one control instant, as estimated.

  Attributes:
    path: being followed.
    arc_length: of each car's reference point, m, (N,).
    errors: relative to the path there, (N,) each.
    speed: of the centre of gravity, m/s, (N,).
    steering: last command, rad, (N,).
    period: s.
    past: slow means of steering command and curvature, rad and 1/m, (N, 2); see `qcar_twin.slow_means`.
    recent: the last second, value by value; None where nobody remembers it.
  """

  path: Path
  arc_length: Array
  errors: Errors
  speed: Array
  steering: Array
  period: float
  past: Array = dataclasses.field(default_factory=lambda: np.zeros((1, 2)))
  recent: Recent | None = None


class Body(Protocol):
  """What a controller can be closed around: less than a `Plant`, so that any simulator of a car will do."""

  @property
  def period(self) -> float:
    """Control period, s."""
    ...

  def begin(self, theta: Array, start: Array) -> Simulation:
    """N cars with parameters (N, P) at states (N, 7), see `qcar_twin.plant`."""
    ...


class Controller(Protocol):
  """A path-tracking controller of N cars; one without memory: what it needs to know is in the situation."""

  @property
  def name(self) -> str:
    """Of its kind, as in agents/data/controllers.toml."""
    ...

  def steer(self, situation: Situation) -> Array:
    """Steering command, rad, (N,); the loop limits it to the car's lock."""
    ...
