"""Hyperparameters of stable-baselines3's algorithms from a file with the keys of the RL zoo.

A TOML file with a table per algorithm: `n_timesteps`, `n_envs`, `normalize`, `policy` and `policy_kwargs` as in the
zoo, everything else an argument of the algorithm's class. "lin_1e-3" is a value that falls linearly to nothing;
`activation_fn` is "relu" or "tanh"; `noise_type` = "normal" with `noise_std` is exploration noise of DDPG and TD3.
"""

import dataclasses
import difflib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from qcar_twin.extras import extra
from qcar_twin.untrusted import UnreadableFile, is_number, read_toml

with extra("Training"):
  import stable_baselines3
  from stable_baselines3.common.base_class import BaseAlgorithm
  from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise
  from torch import nn

FILE = Path(__file__).resolve().parents[1] / "data" / "hyperparameters.toml"
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
  "ppo": stable_baselines3.PPO,
  "sac": stable_baselines3.SAC,
  "td3": stable_baselines3.TD3,
  "ddpg": stable_baselines3.DDPG,
}
ACTIVATIONS = {"relu": nn.ReLU, "tanh": nn.Tanh}
OWN = ("n_timesteps", "n_envs", "normalize", "policy", "policy_kwargs", "noise_type", "noise_std")


@dataclasses.dataclass(frozen=True)
class Hyperparameters:
  """Of one training.

  Attributes:
    algorithm: a key of ALGORITHMS.
    steps: environment steps of all cars together.  cars: side by side.
    normalise: arguments of SB3's VecNormalize; None for none. Observations are of order one already.
    policy: its name in SB3.  policy_kwargs: as in the file.
    noise: standard deviation of exploration noise, share of the largest rate; 0 for none.
    rest: arguments of the algorithm's class, as in the file.
  """

  algorithm: str
  steps: int
  cars: int
  normalise: dict[str, bool] | None
  policy: str
  policy_kwargs: dict[str, Any]
  noise: float
  rest: dict[str, Any]

  def arguments(self) -> dict[str, Any]:
    """Keyword arguments of the algorithm's class."""
    given: dict[str, Any] = {name: _scheduled(value) for name, value in self.rest.items()}
    kwargs = dict(self.policy_kwargs)
    if "activation_fn" in kwargs:
      kwargs["activation_fn"] = ACTIVATIONS[kwargs["activation_fn"]]
    if self.noise:
      base = NormalActionNoise(np.zeros(1), np.full(1, self.noise))
      given["action_noise"] = VectorizedActionNoise(base, self.cars)
    return given | {"policy_kwargs": kwargs}


def read_hyperparameters(algorithm: str, file: Path = FILE) -> Hyperparameters:
  """The table of an algorithm.

  Raises:
    KeyError: no such algorithm or key, with the nearest one.
    UnreadableFile: the file says nothing of the algorithm, or a value is none.
  """
  if algorithm not in ALGORITHMS:
    near = difflib.get_close_matches(algorithm, ALGORITHMS, n=1) or list(ALGORITHMS)
    raise KeyError(f"no algorithm '{algorithm}'; did you mean {', '.join(near)}?")
  table = read_toml(file).get(algorithm)
  if not isinstance(table, dict):
    raise UnreadableFile(f"{file}: has no table [{algorithm}]; write one, with the keys of {FILE.name}")
  known = [
    n for n in inspect.signature(ALGORITHMS[algorithm].__init__).parameters if n not in ("self", "env", "policy")
  ]
  for name in table:
    if name not in (*OWN, *known):
      near = difflib.get_close_matches(name, (*OWN, *known), n=1) or OWN
      raise KeyError(f"{file}: [{algorithm}] has no '{name}'; did you mean {', '.join(near)}?")
  for name in ("n_timesteps", "n_envs"):
    if not (is_number(table.get(name)) and table[name] >= 1):
      raise UnreadableFile(f"{file}: [{algorithm}] {name} must be a number from 1 on")
  kwargs, normalise, noise = table.get("policy_kwargs", {}), table.get("normalize"), table.get("noise_std", 0.0)
  activation = kwargs.get("activation_fn", "relu") if isinstance(kwargs, dict) else None
  if activation not in ACTIVATIONS or not (normalise is None or isinstance(normalise, dict)) or not is_number(noise):
    kinds = "policy_kwargs and normalize are tables, noise_std is a number, activation_fn is relu or tanh"
    raise UnreadableFile(f"{file}: [{algorithm}] {kinds}")
  rest = {name: value for name, value in table.items() if name not in OWN}
  policy = str(table.get("policy", "MlpPolicy"))
  steps, cars = int(table["n_timesteps"]), int(table["n_envs"])
  return Hyperparameters(algorithm, steps, cars, normalise, policy, kwargs, float(noise), rest)


def _scheduled(value: Any) -> float | int | str | Callable[[float], float]:
  """A value, or a function of the share of the training that is left."""
  if not (isinstance(value, str) and value.startswith("lin_")):
    return value
  start = float(value.removeprefix("lin_"))
  return lambda left: left * start
