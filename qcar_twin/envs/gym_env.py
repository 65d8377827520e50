"""The task as a gymnasium environment of one car."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.envs.fleet import Fleet
from qcar_twin.envs.task import TrackingTask
from qcar_twin.extras import extra

with extra("The gymnasium environment"):
  import gymnasium
  from gymnasium import spaces

Observation = NDArray[np.float32]


def observation_space(size: int = 4) -> spaces.Box:
  """Cross-track error, its rate, heading error, its rate: m, m/s, rad, rad/s, and what else is seen; unbounded."""
  return spaces.Box(-np.inf, np.inf, (size,), np.float32)


def action_space(task: TrackingTask) -> spaces.Box:
  """Steering rate, rad/s."""
  return spaces.Box(-task.largest_rate, task.largest_rate, (1,), np.float32)


class PathTrackingEnv(gymnasium.Env):
  """One car on the path-tracking task.

  Args:
    fleet: of one car; the environment owns it.
    render_mode: "rgb_array" for pictures of the chase camera, or None.
  """

  metadata = {"render_modes": ["rgb_array"], "render_fps": 100}

  def __init__(self, fleet: Fleet, render_mode: str | None = None):
    if fleet.count != 1:
      raise ValueError(f"a gymnasium environment drives one car, not {fleet.count}; use FleetVecEnv")
    self.fleet, self.render_mode = fleet, render_mode
    self.observation_space = observation_space()
    self.action_space = action_space(fleet.task)
    self._begun = False
    self._film: Any = None

  def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
    """A new episode; with a seed everything random restarts from it."""
    super().reset(seed=seed)
    if seed is not None:
      self.fleet.seed([seed])
    elif self._begun:
      self.fleet.restart(np.ones(1, dtype=bool))
    self._begun = True
    return self._observation(), self._info()

  def step(self, action: NDArray[np.float32]):
    outcome = self.fleet.step(np.asarray(action, dtype=np.float64))
    info = self._info()
    return (
      self._observation(),
      float(outcome.reward[0]),
      bool(outcome.terminated[0]),
      bool(outcome.truncated[0]),
      info,
    )

  def render(self) -> NDArray[np.uint8] | None:
    """A picture (480, 640, 3), or None without a render mode."""
    if self.render_mode is None:
      return None
    if self._film is None:
      from qcar_twin.rendering.film import Film  # needs OpenGL, which training does not

      self._film = Film(self.fleet.task.path)
    return self._film.frame(self.fleet.signals[0])

  def close(self) -> None:
    if self._film is not None:
      self._film.close()
      self._film = None

  def _observation(self) -> Observation:
    return self.fleet.observation[0].astype(np.float32)

  def _info(self) -> dict[str, float]:
    fleet = self.fleet
    return {"cross_track_error": float(fleet.cross_track[0]), "arc_length": float(fleet.arc_length[1, 0])}
