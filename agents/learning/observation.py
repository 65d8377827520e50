"""What an agent sees beyond the paper's four errors.

The federated filter predicts with the steering command. A linkage it does not know bends its estimate to one
side; command, curvature and their slow means, or the last second of them, give away by how much. An agent that sees
them can learn it, one that sees the four errors alone cannot.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from qcar_twin.envs.fleet import Fleet
from qcar_twin.envs.task import ERROR_SCALE
from qcar_twin.paths import Path
from qcar_twin.recent import REMEMBERED, Recent
from qcar_twin.slow_means import MEMORY

Array = NDArray[np.float64]
STEERING_SCALE, CURVATURE_SCALE, SPEED_SCALE = 2.0, 0.6, 1.0  # 1/rad, m, s/m: what is seen becomes of order one
RECENT_SCALE = (ERROR_SCALE[0], ERROR_SCALE[2], STEERING_SCALE, CURVATURE_SCALE)  # of REMEMBERED


@dataclasses.dataclass(frozen=True)
class ObservationSpec:
  """The paper's four errors with the defaults.

  Attributes:
    steering: also the last steering command, rad.
    previews: also the path's curvature, 1/m, so far ahead, m; 0 is at the car.
    past: also the slow means of steering command and curvature, rad and 1/m, see `qcar_twin.slow_means`.
    speed: also the speed as estimated, m/s, last of all.
    history: also cross-track error, heading error, steering command and curvature so long ago, s; `qcar_twin.recent`.
  """

  steering: bool = False
  previews: tuple[float, ...] = ()
  past: bool = False
  history: tuple[float, ...] = ()
  speed: bool = False

  @property
  def size(self) -> int:
    """Numbers seen per car."""
    return len(self.names)

  @property
  def scale(self) -> tuple[float, ...]:
    """What the numbers beyond the four errors are multiplied with in the network."""
    now = (STEERING_SCALE,) * self.steering + (CURVATURE_SCALE,) * len(self.previews)
    before = (STEERING_SCALE, CURVATURE_SCALE) * self.past + RECENT_SCALE * len(self.history)
    return now + before + (SPEED_SCALE,) * self.speed

  @property
  def names(self) -> tuple[str, ...]:
    """What is seen, with units."""
    errors = ("cross_track_error m", "its rate m/s", "heading_error rad", "its rate rad/s")
    ahead = tuple(f"curvature {x:g} m ahead 1/m" for x in self.previews)
    past = ("mean steering_command rad", "mean curvature 1/m")
    before = tuple(f"{name} {lag:g} s ago {unit}" for lag in self.history for name, unit in map(str.split, REMEMBERED))
    return (
      errors
      + ("steering_command rad",) * self.steering
      + ahead
      + past * self.past
      + before
      + ("speed m/s",) * self.speed
    )

  def look(
    self,
    errors: Array,
    steering: Array,
    past: Array,
    path: Path,
    arc_length: Array,
    recent: Recent | None = None,
    speed: Array | None = None,
  ) -> Array:
    """What is seen, (N, size).

    Args:
      errors: the four, (N, 4).  steering: last command, rad, (N,).  past: slow means, (N, 2).
      path, arc_length: and where on it the cars are, m, (N,).
      recent: the last second, where it is seen.  speed: m/s, (N,), where it is seen.

    Raises:
      ValueError: the last second or the speed is seen, and is not given.
    """
    parts = [errors] + [steering[:, None]] * self.steering
    if self.previews:
      parts.append(path.at(arc_length[:, None] + np.array(self.previews)).curvature)
    parts += [past] * self.past
    if self.history:
      if recent is None:
        raise ValueError("this policy sees the last second, which nobody remembers here: give `recent`")
      parts.append(recent.before(self.history).reshape(len(errors), -1))
    if self.speed:
      if speed is None:
        raise ValueError("this policy sees the speed, which nobody tells here: give `speed`")
      parts.append(np.nan_to_num(speed)[:, None])
    return np.concatenate(parts, axis=1)

  def of(self, fleet: Fleet) -> Array:
    """What is seen of a fleet, by its cars' own estimates, (N, size)."""
    path, speed = fleet.task.path, fleet.cars.estimate.speed
    return self.look(fleet.observation, fleet.steering, fleet.past, path, fleet.arc_length[0], fleet.recent, speed)


LOOKS_BACK = tuple(float(lag) for lag in np.round(np.linspace(0.2, MEMORY, 5), 3))  # s
OBSERVATIONS = {
  "errors": ObservationSpec(),
  "wide": ObservationSpec(steering=True, previews=(0.0, 0.15), past=True),
  "history": ObservationSpec(steering=True, previews=(0.0, 0.15), history=LOOKS_BACK),
  "any_speed": ObservationSpec(
    steering=True, previews=(0.0, 0.15, 0.3, 0.45, 0.6), past=True, history=LOOKS_BACK, speed=True
  ),
}
"""What can be seen, by name: the paper's four errors; or also what gives the filter's bias away, as means over the last
second or as five looks back into it; or both, the path as far ahead as a car of 1.5 m/s drives in 0.4 s, and the
speed."""
