"""The task as a vectorised environment of stable-baselines3: N cars in one batch, restarted one by one."""

import secrets
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.envs.fleet import Fleet
from qcar_twin.envs.spaces import FleetView, Interface
from qcar_twin.extras import extra

with extra("The vectorised environment"):
  from stable_baselines3.common.vec_env import VecEnv

Indices = int | Sequence[int] | None


class FleetVecEnv(VecEnv):
  """A fleet as SB3 wants it: a finished car is restarted at once, its last observation is in its info.

  Infos of finished episodes also hold SB3's `episode` entry: return `r`, length `l`, and the root mean square of
  the true cross-track error `rmse`, m; and `reward_terms`, the return by its terms. Cars that were never seeded are
  seeded at random, each for itself.

  Args:
    view: what the agent sees; the four errors without it.
    normalised: numbers of order one instead of SI units, see `spaces.Interface`.
    seeded: the fleet's own seeds count as given: the first reset begins their episodes.
  """

  def __init__(self, fleet: Fleet, view: FleetView | None = None, normalised: bool = False, seeded: bool = True):
    self.fleet, self.interface = fleet, Interface(view, normalised)
    self.render_mode = None
    self._actions = np.zeros(fleet.count)
    self._begun, self._seeded = False, seeded
    self._terms: dict[str, NDArray[np.float64]] = {}
    self._return, self._squares = np.zeros(fleet.count), np.zeros(fleet.count)
    super().__init__(fleet.count, self.interface.observation_space, self.interface.action_space(fleet))

  def reset(self) -> NDArray[np.float32]:
    if any(seed is not None for seed in self._seeds) or not (self._begun or self._seeded):
      self.fleet.seed([secrets.randbits(62) if seed is None else int(seed) for seed in self._seeds])
    elif self._begun:
      self.fleet.restart(np.ones(self.num_envs, dtype=bool))
    self._begun = True
    self._return[:], self._squares[:], self._terms = 0.0, 0.0, {}
    self._reset_seeds()
    self._reset_options()
    return self._seen()

  def step_async(self, actions: np.ndarray) -> None:
    self._actions = actions

  def step_wait(self):
    outcome = self.fleet.step(self.interface.rate(self._actions, self.fleet))
    self._return += outcome.reward
    self._terms = {name: self._terms.get(name, 0.0) + value for name, value in outcome.terms.items()}
    self._squares += np.nan_to_num(self.fleet.cross_track) ** 2
    done = outcome.terminated | outcome.truncated
    infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
    observation = self._seen()
    if done.any():
      for i in np.flatnonzero(done):
        infos[i] = self._last_words(int(i), observation[i], bool(outcome.truncated[i]))
      self.fleet.restart(done)
      self._return[done], self._squares[done] = 0.0, 0.0
      self._terms = {name: np.where(done, 0.0, value) for name, value in self._terms.items()}
      observation = self._seen()
    return observation, outcome.reward.astype(np.float32), done, infos

  def _seen(self) -> NDArray[np.float32]:
    return self.interface.see(self.fleet)

  def _last_words(self, i: int, observation: NDArray[np.float32], truncated: bool) -> dict[str, Any]:
    steps = int(self.fleet.episode_steps[i])
    rmse = float(np.sqrt(self._squares[i] / steps))
    episode = {"r": float(self._return[i]), "l": steps, "rmse": rmse, "finished": truncated}
    terms = {name: float(value[i]) for name, value in self._terms.items()}
    return {
      "terminal_observation": observation,
      "TimeLimit.truncated": truncated,
      "episode": episode,
      "reward_terms": terms,
    }

  def close(self) -> None:
    """Nothing to let go of."""

  def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
    return [getattr(self, attr_name)] * len(self._cars(indices))

  def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
    setattr(self, attr_name, value)

  def env_method(self, method_name: str, *method_args, indices: Indices = None, **method_kwargs) -> list[Any]:
    raise NotImplementedError(f"the cars of a fleet are not environments of their own: no '{method_name}' for one")

  def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
    return [False] * len(self._cars(indices))

  def _cars(self, indices: Indices) -> Sequence[int]:
    return list(self._get_indices(indices))
