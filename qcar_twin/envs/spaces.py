"""What an agent sees of a fleet and how its action is read: in SI units, or as numbers of order one."""

import dataclasses
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.envs.fleet import Fleet
from qcar_twin.envs.task import ERROR_SCALE
from qcar_twin.extras import extra

with extra("The gymnasium environment"):
  from gymnasium import spaces

Array = NDArray[np.float64]
Observation = NDArray[np.float32]
LIMIT = 10.0  # of a normalised observation; the cross-track error at which a car is lost is 4


class FleetView(Protocol):
  """What an agent sees of a fleet, where that is more than the paper's four errors."""

  @property
  def size(self) -> int:
    """Numbers seen per car; the first four are the errors."""
    ...

  @property
  def scale(self) -> tuple[float, ...]:
    """What the numbers beyond the four errors are multiplied with to become of order one."""
    ...

  def of(self, fleet: Fleet) -> Array:
    """What is seen, (N, size), in SI units."""
    ...


@dataclasses.dataclass(frozen=True)
class Interface:
  """Between an agent and a fleet.

  Attributes:
    view: what the agent sees; the four errors without it.
    normalised: observations times their scale, held within +-LIMIT, and actions in [-1, 1] for rates up to the largest;
      else both in SI units.
  """

  view: FleetView | None = None
  normalised: bool = False

  @property
  def size(self) -> int:
    """Numbers seen per car."""
    return self.view.size if self.view else len(ERROR_SCALE)

  @property
  def scale(self) -> Array:
    """Of what is seen, (size,)."""
    return np.array([*ERROR_SCALE, *(self.view.scale if self.view else ())])

  @property
  def observation_space(self) -> spaces.Box:
    """Cross-track error, its rate, heading error, its rate, and what else is seen."""
    limit = LIMIT if self.normalised else np.inf
    return spaces.Box(-limit, limit, (self.size,), np.float32)

  def action_space(self, fleet: Fleet) -> spaces.Box:
    """Steering rate: of the largest, or rad/s."""
    largest = 1.0 if self.normalised else fleet.task.largest_rate
    return spaces.Box(-largest, largest, (1,), np.float32)

  def see(self, fleet: Fleet) -> Observation:
    """What is seen, (N, size)."""
    seen = self.view.of(fleet) if self.view else fleet.observation
    return (np.clip(seen * self.scale, -LIMIT, LIMIT) if self.normalised else seen).astype(np.float32)

  def rate(self, action: NDArray[np.floating], fleet: Fleet) -> Array:
    """Steering rates, rad/s, (N,), of actions (N, 1)."""
    asked = np.asarray(action, dtype=np.float64).reshape(fleet.count)
    return asked * fleet.task.largest_rate if self.normalised else asked
