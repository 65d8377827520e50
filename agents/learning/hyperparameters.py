"""Hyperparameters of stable-baselines3's algorithms from a file as the RL zoo has them.

A YAML file with a table per environment, or a table `default`. Own keys are `n_timesteps`, `n_envs`, `policy`,
`normalize`, `policy_kwargs`, `env_kwargs`, `noise_type` and `noise_std`; everything else is an argument of the
algorithm's class. "lin_1e-3" is a value that falls linearly to nothing, "dict(net_arch=[64, 64],
activation_fn=nn.ReLU)" a table: such a text is read as data, never run.
"""

import ast
import collections.abc
import dataclasses
import difflib
import inspect
import re
import types
import typing
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.learning.environments import ENV_ID, one_of_them, options_from
from agents.learning.observation import OBSERVATIONS
from qcar_twin.extras import extra
from qcar_twin.untrusted import UnreadableFile, is_number, read_yaml

with extra("Training"):
  import stable_baselines3
  from stable_baselines3.common.base_class import BaseAlgorithm
  from stable_baselines3.common.noise import NormalActionNoise, OrnsteinUhlenbeckActionNoise, VectorizedActionNoise
  from stable_baselines3.common.vec_env import VecNormalize
  from torch import nn

FOLDER = Path(__file__).resolve().parents[1] / "data" / "hyperparameters"
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
  "ppo": stable_baselines3.PPO,
  "sac": stable_baselines3.SAC,
  "td3": stable_baselines3.TD3,
  "ddpg": stable_baselines3.DDPG,
}
POLICY = "MlpPolicy"  # the only one that a policy folder can hold
WIDE = "wide"  # what the registered environment shows where nothing is said
ACTIVATIONS = {"relu": nn.ReLU, "tanh": nn.Tanh}
NOISES = {"normal": NormalActionNoise, "ornstein-uhlenbeck": OrnsteinUhlenbeckActionNoise}
OWN = ("n_timesteps", "n_envs", "normalize", "policy", "policy_kwargs", "env_kwargs", "noise_type", "noise_std")
NOT_ASKED = ("self", "env", "policy", "seed", "device", "verbose", "tensorboard_log", "action_noise")
FALLING = re.compile(r"lin_(\d+\.?\d*(?:[eE][-+]?\d+)?)")


@dataclasses.dataclass(frozen=True)
class Hyperparameters:
  """Of one training.

  Attributes:
    algorithm: a key of ALGORITHMS.
    steps: environment steps of all cars together.  cars: side by side.
    normalise: arguments of SB3's VecNormalize; None for none. Observations are of order one already.
    policy_kwargs: as in the file, the activation by its name in ACTIVATIONS.
    noise: standard deviation of exploration noise, share of the largest rate; 0 for none.  noise_type: a key of NOISES.
    env_kwargs: options of the environment; none for those of the training.
    observation: what is seen, a key of `OBSERVATIONS`.
    rest: arguments of the algorithm's class, as in the file.
  """

  algorithm: str
  steps: int
  cars: int
  normalise: dict[str, Any] | None = None
  policy_kwargs: dict[str, Any] = dataclasses.field(default_factory=dict)
  noise: float = 0.0
  noise_type: str = "normal"
  env_kwargs: dict[str, Any] = dataclasses.field(default_factory=dict)
  rest: dict[str, Any] = dataclasses.field(default_factory=dict)
  observation: str = WIDE

  def arguments(self) -> dict[str, Any]:
    """Keyword arguments of the algorithm's class."""
    given: dict[str, Any] = {name: _scheduled(value) for name, value in self.rest.items()}
    kwargs = dict(self.policy_kwargs)
    if "activation_fn" in kwargs:
      kwargs["activation_fn"] = ACTIVATIONS[kwargs["activation_fn"]]
    if self.noise:
      base = NOISES[self.noise_type](np.zeros(1), np.full(1, self.noise))
      given["action_noise"] = VectorizedActionNoise(base, self.cars)
    return given | {"policy_kwargs": kwargs}


def file_of(algorithm: str) -> Path:
  """The file that comes with the package. Raises KeyError: no such algorithm, with the nearest one."""
  _known(algorithm, ALGORITHMS, "there is no algorithm")
  return FOLDER / f"{algorithm}.yml"


def read_hyperparameters(algorithm: str, file: Path | None = None) -> Hyperparameters:
  """Of an algorithm from a file, or from the one that comes with the package.

  Raises:
    KeyError: no such algorithm or key, with the nearest one.
    FileNotFoundError, UnreadableFile: the file says nothing of the environment, or a value is none.
  """
  file = file or file_of(algorithm)
  kind = ALGORITHMS[_known(algorithm, ALGORITHMS, "there is no algorithm")]
  if file.suffix not in (".yml", ".yaml"):
    raise UnreadableFile(
      f"{file}: hyperparameters are a YAML file as the RL zoo's; write one like {file_of(algorithm)}"
    )
  tables = read_yaml(file)
  table = tables.get(ENV_ID, tables.get("default"))
  if not isinstance(table, dict):
    raise UnreadableFile(f"{file}: has no table {ENV_ID}; write one, like that of {file_of(algorithm)}")
  arguments = inspect.signature(kind.__init__).parameters
  known = {name: p.annotation for name, p in arguments.items() if name not in NOT_ASKED and name[0] != "_"}
  for name in table:
    _known(name, [*OWN, *known], f"{file}: {algorithm} has no key")
  steps, cars = (_whole(table, name, file) for name in ("n_timesteps", "n_envs"))
  if (policy := table.get("policy", POLICY)) != POLICY:
    raise UnreadableFile(f"{file}: policy {policy!r} cannot be exported; use {POLICY}")
  rest = {name: _fitting(value, known[name], f"{file}: {name}") for name, value in table.items() if name not in OWN}
  env, observation = _env_kwargs(table, str(file))
  noise, noise_type = _noise(table, "action_noise" in arguments, f"{file}: {algorithm}")
  return Hyperparameters(
    algorithm,
    steps,
    cars,
    _normalise(table, str(file)),
    _policy_kwargs(table, kind, str(file)),
    noise,
    noise_type,
    env,
    rest,
    observation,
  )


def _known(name: str, names: Collection[str], what: str) -> str:
  """The name. Raises KeyError where it is none of the names, with the nearest one."""
  if name not in names:
    near = difflib.get_close_matches(str(name), names, n=1)
    raise KeyError(f"{what} '{name}'; " + (f"did you mean {near[0]}?" if near else f"there are {', '.join(names)}"))
  return name


def _whole(table: Mapping[str, Any], name: str, file: Path) -> int:
  value = table.get(name)
  if not (is_number(value) and value >= 1 and float(value).is_integer()):  # type: ignore[operator, arg-type]
    raise UnreadableFile(f"{file}: {name} must be a whole number from 1 on, not {value!r}")
  return int(value)  # type: ignore[arg-type]


def _table(value: Any, what: str) -> dict[str, Any]:
  """A table, given as one or as the text of a call of dict with plain values."""
  if isinstance(value, str):
    cure = 'write it like "dict(net_arch=[64, 64], activation_fn=nn.ReLU)"'
    try:
      value = _plain(ast.parse(value.strip(), mode="eval").body)
    except (SyntaxError, ValueError, RecursionError) as error:
      raise UnreadableFile(f"{what} {value!r} is no table; {cure}") from error
  if not isinstance(value, dict):
    raise UnreadableFile(f"{what} must be a table, not {value!r}")
  return value


def _plain(node: ast.expr) -> Any:
  """A literal, a dict(name=...) of such, or the last part of a name such as nn.ReLU; ValueError for all else."""
  if isinstance(node, ast.Attribute):
    return node.attr
  if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "dict" and not node.args:
    if all(pair.arg for pair in node.keywords):
      return {str(pair.arg): _plain(pair.value) for pair in node.keywords}
  return ast.literal_eval(node)


def _policy_kwargs(table: Mapping[str, Any], kind: type[BaseAlgorithm], file: str) -> dict[str, Any]:
  kwargs = dict(_table(table.get("policy_kwargs", {}), f"{file}: policy_kwargs"))
  known = inspect.signature(kind.policy_aliases[POLICY].__init__).parameters
  for name in kwargs:
    _known(name, [n for n in known if n != "self" and "_space" not in n], f"{file}: policy_kwargs has no key")
  if "activation_fn" in kwargs:
    name = str(kwargs["activation_fn"]).lower()
    if name not in ACTIVATIONS:
      raise UnreadableFile(
        f"{file}: activation_fn {kwargs['activation_fn']!r} cannot be exported; use nn.ReLU or nn.Tanh"
      )
    kwargs["activation_fn"] = name
  if not all(is_number(n) and n >= 1 and n == int(n) for n in _sizes(kwargs.get("net_arch", []))):
    raise UnreadableFile(f"{file}: net_arch must be a list of whole numbers, not {kwargs['net_arch']!r}")
  return kwargs


def _sizes(arch: Any) -> list[Any]:
  """All widths of layers, of one list or of a table of lists such as pi and vf."""
  parts = list(arch.values()) if isinstance(arch, dict) else [arch]
  return [n for part in parts for n in (part if isinstance(part, list | tuple) else [None])]


def _normalise(table: Mapping[str, Any], file: str) -> dict[str, Any] | None:
  given = table.get("normalize", False)
  if given is False or given is None:
    return None
  given = {} if given is True else _table(given, f"{file}: normalize")
  for name in given:
    _known(
      name, [n for n in inspect.signature(VecNormalize).parameters if n != "venv"], f"{file}: normalize has no key"
    )
  if given.get("norm_obs", True):
    cure = 'normalize: "dict(norm_obs=False, norm_reward=True)"'
    raise UnreadableFile(
      f"{file}: normalised observations cannot be exported, and are of order one already; use {cure}"
    )
  return dict(given)


def _noise(table: Mapping[str, Any], has: bool, where: str) -> tuple[float, str]:
  kind, std = table.get("noise_type"), table.get("noise_std")
  if kind is None and std is None:
    return 0.0, "normal"
  if not has:
    raise UnreadableFile(f"{where} explores by its own policy; leave out noise_type and noise_std")
  if not (is_number(std) and std >= 0.0):  # type: ignore[operator]
    raise UnreadableFile(f"{where}: noise_std must be a number from 0 on, not {std!r}")
  return float(std), _known(str(kind), NOISES, f"{where}: there is no noise_type")  # type: ignore[arg-type]


def _env_kwargs(table: Mapping[str, Any], file: str) -> tuple[dict[str, Any], str]:
  """Options of the environment, and what is seen."""
  kwargs = dict(_table(table.get("env_kwargs", {}), f"{file}: env_kwargs"))
  observation = kwargs.pop("observation", WIDE)
  try:
    options_from(kwargs)
    one_of_them("observation", observation, tuple(OBSERVATIONS))
  except (TypeError, ValueError) as error:
    raise UnreadableFile(f"{file}: env_kwargs: {error}") from error
  return kwargs, observation


def _fitting(value: Any, kind: Any, what: str) -> Any:
  """A value as an argument of this kind takes it. Raises UnreadableFile where it takes none such."""
  unions = (types.UnionType, typing.Union)
  kinds = typing.get_args(kind) if typing.get_origin(kind) in unions else (kind,)
  for one in kinds:
    if _fits(value, one):
      return int(value) if one is int else tuple(value) if isinstance(value, list) else value
  names = " or ".join(dict.fromkeys(_said(one) for one in kinds))
  raise UnreadableFile(f"{what} must be {names}, not {value!r}")


def _fits(value: Any, kind: Any) -> bool:
  origin = typing.get_origin(kind) or kind
  if origin is collections.abc.Callable:
    return isinstance(value, str) and bool(FALLING.fullmatch(value))
  if kind is float:
    return is_number(value)
  if kind is int:
    return is_number(value) and float(value).is_integer()
  if origin is tuple:
    return isinstance(value, list | tuple) and len(value) == len(typing.get_args(kind))
  return origin in (bool, str, dict, types.NoneType) and isinstance(value, origin)


def _said(kind: Any) -> str:
  if (typing.get_origin(kind) or kind) is collections.abc.Callable:
    return "falling like lin_1e-3"
  names = {int: "a whole number", float: "a number", bool: "true or false", str: "a text", types.NoneType: "null"}
  return names.get(kind, "a pair" if typing.get_origin(kind) is tuple else "a table")


def _scheduled(value: Any) -> Any | Callable[[float], float]:
  """A value, or a function of the share of the training that is left."""
  falling = FALLING.fullmatch(value) if isinstance(value, str) else None
  if not falling:
    return value
  start = float(falling[1])
  return lambda left: left * start
