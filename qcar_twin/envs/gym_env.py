"""The task as a gymnasium environment of one car, and of many cars in one batch."""

import os
import secrets
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.envs.fleet import Fleet, Outcome
from qcar_twin.envs.spaces import Interface, Observation
from qcar_twin.extras import extra

with extra("The gymnasium environment"):
  import gymnasium
  from gymnasium.vector import AutoresetMode, VectorEnv
  from gymnasium.vector.utils import batch_space


class PathTrackingEnv(gymnasium.Env):
  """One car on the path-tracking task.

  Without a seed, an environment's first episode is drawn at random, later ones follow from it.

  Args:
    fleet: of one car; the environment owns it.
    render_mode: "rgb_array" for pictures of the chase camera, or None.
    interface: what is seen and how actions are read; the four errors in SI units without it.
  """

  metadata = {"render_modes": ["rgb_array"], "render_fps": 100}  # an instance has its own clock's rate

  def __init__(self, fleet: Fleet, render_mode: str | None = None, interface: Interface | None = None):
    if fleet.count != 1:
      raise ValueError(f"a gymnasium environment drives one car, not {fleet.count}; use FleetVecEnv or FleetVectorEnv")
    if render_mode not in (None, *self.metadata["render_modes"]):
      raise ValueError(f"no render mode '{render_mode}'; there are {', '.join(self.metadata['render_modes'])}, or None")
    self.fleet, self.render_mode, self.interface = fleet, render_mode, interface or Interface()
    self.metadata = {**type(self).metadata, "render_fps": round(1.0 / fleet.task.period)}
    self.observation_space = self.interface.observation_space
    self.action_space = self.interface.action_space(fleet)
    self._begun = False
    self._films: dict[tuple[int, int], Any] = {}  # by process and thread, to which OpenGL belongs

  def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
    """A new episode; with a seed everything random restarts from it."""
    super().reset(seed=seed)
    if seed is not None:
      self.fleet.seed([seed])
    elif self._begun:
      self.fleet.restart(np.ones(1, dtype=bool))
    else:
      self.fleet.seed([secrets.randbits(62)])
    self._begun = True
    return self._observation(), self._info(None)

  def step(self, action: NDArray[np.float32]):
    """A control period; a NaN holds the steering and the car is lost."""
    outcome = self.fleet.step(self.interface.rate(action, self.fleet))
    ends = bool(outcome.terminated[0]), bool(outcome.truncated[0])
    return self._observation(), float(outcome.reward[0]), *ends, self._info(outcome)

  def render(self) -> NDArray[np.uint8] | None:
    """A picture (480, 640, 3), or None without a render mode.

    OpenGL belongs to the thread that opened it: every thread has a scene of its own. In a process that was forked
    after a picture was made there is none.

    Raises:
      RenderingUnavailable: there is no OpenGL, or it was opened before this process was forked.
    """
    if self.render_mode is None:
      return None
    here = os.getpid(), threading.get_ident()
    if here not in self._films:
      from qcar_twin.rendering.film import Film  # needs OpenGL, which training does not

      self._films[here] = Film(self.fleet.task.path)
    return self._films[here].frame(self.fleet.signals[0])

  def close(self) -> None:
    """Let go of this thread's scene; those of other threads are theirs."""
    film = self._films.pop((os.getpid(), threading.get_ident()), None)
    if film is not None:
      film.close()

  def snapshot(self) -> Fleet:
    """The car, its sensors, filter and random streams as they are now; `restore` goes on from there."""
    return self.fleet.snapshot()

  def restore(self, snapshot: Fleet) -> tuple[Observation, dict[str, Any]]:
    """Go on from a snapshot, as often as one likes; what is seen there."""
    self.fleet, self._begun = snapshot.snapshot(), True
    return self._observation(), self._info(None)

  def __getstate__(self) -> dict[str, Any]:
    """For a copy or another process: scenes are opened anew there."""
    return {**vars(self), "_films": {}}

  def _observation(self) -> Observation:
    return self.interface.see(self.fleet)[0]

  def _info(self, outcome: Outcome | None) -> dict[str, Any]:
    """The true cross-track error and arc length, m; after a step the reward's terms by name."""
    fleet = self.fleet
    info: dict[str, Any] = {
      "cross_track_error": float(fleet.cross_track[0]),
      "arc_length": float(fleet.arc_length[1, 0]),
    }
    if outcome is not None:
      info["reward_terms"] = {name: float(value[0]) for name, value in outcome.terms.items()}
    return info


class FleetVectorEnv(VectorEnv):
  """A fleet as gymnasium's vector environment. A finished car is restarted in the same step; how it ended is in
  `final_obs` and `final_info`.

  Args:
    fleet: the environment owns it.
    interface: what is seen and how actions are read; the four errors in SI units without it.
  """

  metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}

  def __init__(self, fleet: Fleet, interface: Interface | None = None):
    self.fleet, self.interface, self.num_envs = fleet, interface or Interface(), fleet.count
    self.single_observation_space = self.interface.observation_space
    self.single_action_space = self.interface.action_space(fleet)
    self.observation_space = batch_space(self.single_observation_space, fleet.count)
    self.action_space = batch_space(self.single_action_space, fleet.count)
    self._begun = False

  def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None):
    """New episodes of all cars, or of those in `options["reset_mask"]`, (N,); car i of seed s has seed s + i.

    The first reset begins all cars, whatever the mask.

    Raises:
      ValueError: a mask with a seed, which begins all cars anew.
    """
    mask = (options or {}).get("reset_mask")
    if seed is not None and mask is not None:
      raise ValueError("reset with a seed and a reset_mask: a seed begins all cars anew; give one or the other")
    if isinstance(seed, (int, np.integer)):
      seed = [int(seed) + i for i in range(self.num_envs)]
    if seed is not None or not self._begun:
      given = seed if seed is not None else [None] * self.num_envs
      self.fleet.seed([secrets.randbits(62) if one is None else int(one) for one in given])
    else:
      self.fleet.restart(np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask, dtype=bool))
    self._begun = True
    return self.interface.see(self.fleet), self._info()

  def step(self, actions: NDArray[np.float32]):
    """A control period of all cars."""
    outcome = self.fleet.step(self.interface.rate(actions, self.fleet))
    done = outcome.terminated | outcome.truncated
    observation, info = self.interface.see(self.fleet), self._info()
    info["reward_terms"] = dict(outcome.terms)
    if done.any():
      info |= {"final_obs": observation.copy(), "_final_obs": done, "final_info": dict(info), "_final_info": done}
      self.fleet.restart(done)
      observation = self.interface.see(self.fleet)
      info |= self._info()
    return observation, outcome.reward.copy(), outcome.terminated, outcome.truncated, info

  def _info(self) -> dict[str, Any]:
    """True cross-track errors and arc lengths, m, (N,)."""
    return {"cross_track_error": self.fleet.cross_track.copy(), "arc_length": self.fleet.arc_length[1].copy()}
