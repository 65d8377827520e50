"""One fleet's cars driven by several processes, as one vectorised environment of stable-baselines3.

What happens to a car does not depend on which other cars drive with it: so many processes give what one gives.
"""

import multiprocessing
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from qcar_twin.envs.vector_env import FleetVecEnv, Indices
from qcar_twin.extras import extra

with extra("The vectorised environment"):
  from stable_baselines3.common.vec_env import CloudpickleWrapper, VecEnv

Maker = Callable[[], FleetVecEnv]


class WorkersVecEnv(VecEnv):
  """Cars of several `FleetVecEnv`, each in a process of its own, one after another.

  Args:
    makers: make the parts, each in its process.
    counts: cars of each.

  Raises:
    RuntimeError: from any method, when a process has ended.
  """

  def __init__(self, makers: Sequence[Maker], counts: Sequence[int]):
    self._edges = np.cumsum([0, *counts])
    context = multiprocessing.get_context("spawn")  # a forked process would inherit torch's threads
    self._pipes, self._processes = [], []
    for make in makers:
      here, there = context.Pipe()
      process = context.Process(target=_drive, args=(there, CloudpickleWrapper(make)), daemon=True)
      process.start()
      there.close()
      self._pipes.append(here)
      self._processes.append(process)
    self.render_mode = None
    spaces = self._answers()[0]
    super().__init__(int(self._edges[-1]), *spaces)

  def reset(self) -> np.ndarray:
    self._tell("reset", [self._seeds[low:high] for low, high in self._parts()])
    self._reset_seeds()
    self._reset_options()
    return np.concatenate(self._answers())

  def step_async(self, actions: np.ndarray) -> None:
    self._tell("step", [actions[low:high] for low, high in self._parts()])

  def step_wait(self):
    seen, rewards, done, last = zip(*self._answers(), strict=True)
    infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
    for (low, _), words in zip(self._parts(), last, strict=True):
      for i, info in words.items():
        infos[low + i] = info
    return np.concatenate(seen), np.concatenate(rewards), np.concatenate(done), infos

  def close(self) -> None:
    """End the processes."""
    for pipe in self._pipes:
      pipe.close()  # which ends its process
    for process in self._processes:
      process.join()
    self._pipes, self._processes = [], []

  def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
    return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

  def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
    raise NotImplementedError("the cars are in other processes")

  def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
    raise NotImplementedError("the cars are in other processes")

  def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
    return [False] * len(list(self._get_indices(indices)))

  def _parts(self) -> list[tuple[int, int]]:
    return list(zip(self._edges[:-1].tolist(), self._edges[1:].tolist(), strict=True))

  def _tell(self, what: str, parts: Sequence[Any]) -> None:
    try:
      for pipe, part in zip(self._pipes, parts, strict=True):
        pipe.send((what, part))
    except OSError as error:
      raise RuntimeError(ENDED) from error

  def _answers(self) -> list[Any]:
    try:
      return [pipe.recv() for pipe in self._pipes]
    except (EOFError, OSError) as error:
      raise RuntimeError(ENDED) from error


ENDED = "a process that drives cars has ended; its own message is above, --resume goes on from the last checkpoint"


def _drive(pipe: Connection, make: CloudpickleWrapper) -> None:
  """A process: its cars, until the pipe is closed."""
  env = make.var()
  pipe.send((env.observation_space, env.action_space))
  while True:
    try:
      what, part = pipe.recv()
    except EOFError:
      return
    if what == "reset":
      env._seeds = part
      pipe.send(env.reset())
    else:
      env.step_async(part)
      seen, rewards, done, infos = env.step_wait()
      pipe.send((seen, rewards, done, {i: infos[i] for i in np.flatnonzero(done).tolist()}))
