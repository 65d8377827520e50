"""A policy out of a zip that stable-baselines3 saved, without running anything that is in it.

Such a zip holds policy.pth (tensors, read with torch's `weights_only`) and data (JSON, in which classes and spaces lie
as pickles besides a readable account of them: only that is looked at). PPO, A2C, SAC, TD3 and DDPG with an MlpPolicy.
"""

import io
import json
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.learning.observation import OBSERVATIONS
from agents.learning.policy_file import Layers, Policy, load_policy
from qcar_twin.envs.spaces import ERROR_SCALE, LIMIT
from qcar_twin.envs.task import TrackingTask
from qcar_twin.extras import extra
from qcar_twin.untrusted import UnreadableFile, bounded_memory

LARGEST_RATE = next(f.default for f in TrackingTask.__dataclass_fields__.values() if f.name == "largest_rate")
MOST = 200_000_000  # bytes of a zip's parts that are read
ACTORS = {  # hidden layers and output by the algorithm's naming: name of the kind, prefixes, how the output is bounded
  "on-policy": ("mlp_extractor.policy_net.", "action_net.", "clip"),
  "sac": ("actor.latent_pi.", "actor.mu.", "tanh"),
  "deterministic": ("actor.mu.", "", "tanh"),
}


def any_policy(place: Path) -> Policy:
  """A policy folder, or a zip of stable-baselines3.

  Raises:
    FileNotFoundError, UnreadableFile: with the file's name and the cure.
  """
  return policy_from_zip(place) if place.suffix == ".zip" else load_policy(place)


def policy_from_zip(file: Path) -> Policy:
  """The actor of a model that `model.save(file)` wrote, trained on `QcarTwin/PathTracking-v1` or -v0.

  Raises:
    FileNotFoundError: no such file.
    UnreadableFile: it is no such zip, or its policy is none that can be read.
  """
  if not file.is_file():
    raise FileNotFoundError(f"{file}: no such file; stable-baselines3's model.save makes one")
  data, tensors = _parts(file)
  policy = policy_from(tensors, data, str(file))
  return policy


def policy_from(tensors: Mapping[str, Any], data: Mapping[str, Any], where: str) -> Policy:
  """A policy from an actor's tensors by SB3's names and the readable part of its `data`."""
  kind = "on-policy" if "action_net.weight" in tensors else "deterministic"
  kind = "sac" if "actor.log_std.weight" in tensors else kind
  before, last, bound = ACTORS[kind]
  layers = _layers(tensors, before, last, where)
  seen = layers[0][0].shape[1]
  spec = next((spec for spec in OBSERVATIONS.values() if spec.size == seen), None)
  if spec is None or layers[-1][0].shape[0] != 1:
    sizes = " or ".join(str(spec.size) for spec in OBSERVATIONS.values())
    raise UnreadableFile(f"{where}: sees {seen} numbers; a policy of QcarTwin/PathTracking sees {sizes} and gives one")
  hidden = _hidden(data, kind, where)
  space = data.get("observation_space")
  normalised = "inf" not in str(space.get("low", "") if isinstance(space, dict) else "")
  scale = (*ERROR_SCALE, *spec.scale) if normalised else (1.0,) * seen
  if kind == "on-policy" and not normalised:  # its output is in rad/s, a policy's in shares of the largest rate
    layers = (*layers[:-1], tuple(part / LARGEST_RATE for part in layers[-1]))
  return Policy(
    layers,
    scale,
    LARGEST_RATE,
    provenance={"zip": Path(where).name, "result": {"updates": _count(data, "_n_updates")}},
    name=_algorithm(data, kind, tensors),
    observation=spec,
    hidden=hidden,
    bound=bound,
    observation_limit=LIMIT if normalised else float("inf"),
  )


def _parts(file: Path) -> tuple[dict[str, Any], dict[str, Any]]:
  """The readable data and the policy's tensors."""
  try:
    with zipfile.ZipFile(file) as archive:
      for name in ("data", "policy.pth"):
        if archive.getinfo(name).file_size > MOST:
          raise UnreadableFile(f"{file}: {name} is larger than {MOST // 10**6} MB; train a smaller policy")
      data = json.loads(archive.read("data"))
      with bounded_memory(file.stat().st_size):
        tensors = tensors_in(archive, "policy.pth")
  except (KeyError, zipfile.BadZipFile, json.JSONDecodeError, RuntimeError, EOFError, MemoryError) as error:
    raise UnreadableFile(f"{file}: is no zip that stable-baselines3 saved ({error}); save the model again") from error
  if not isinstance(data, dict) or not isinstance(tensors, dict):
    raise UnreadableFile(f"{file}: is no zip that stable-baselines3 saved; save the model again")
  return data, tensors


def tensors_in(archive: zipfile.ZipFile, name: str) -> Any:
  """Tensors and plain values of a part of a zip. Raises UnreadableFile: it holds more, which is not run."""
  with extra("Reading a zip of stable-baselines3"):
    import torch
  try:
    return torch.load(io.BytesIO(archive.read(name)), map_location="cpu", weights_only=True)
  except Exception as error:  # torch's own, whose class differs between versions
    if type(error).__name__ != "UnpicklingError":
      raise
    raise UnreadableFile(f"{archive.filename}: {name} holds more than tensors; save the model again") from error


def _layers(tensors: Mapping[str, Any], before: str, last: str, where: str) -> Layers:
  """Weights and biases of the actor in order."""
  numbers = sorted(
    int(matched[1]) for name in tensors if (matched := re.fullmatch(re.escape(before) + r"(\d+)\.weight", name))
  )
  prefixes = [f"{before}{k}." for k in numbers] + [last] * bool(last)
  try:
    pairs = [(tensors[f"{p}weight"].numpy(), tensors[f"{p}bias"].numpy()) for p in prefixes]
  except (KeyError, AttributeError) as error:
    raise UnreadableFile(f"{where}: has no actor of an MlpPolicy ({error}); train with one") from error
  size = pairs[0][0].shape[1] if pairs else 0
  for weight, bias in pairs:
    if weight.ndim != 2 or weight.shape[1] != size or bias.shape != weight.shape[:1] or not np.isfinite(weight).all():
      raise UnreadableFile(f"{where}: its layers do not fit each other or are not finite; save the model again")
    size = weight.shape[0]
  if not pairs:
    raise UnreadableFile(f"{where}: has no actor of an MlpPolicy; train PPO, SAC, TD3 or DDPG with one")
  return tuple((weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in pairs)


def _hidden(data: Mapping[str, Any], kind: str, where: str) -> str:
  """Activation of the hidden layers: what the readable account says, else SB3's default of the algorithm."""
  given = data.get("policy_kwargs")
  said = str(given.get("activation_fn", "")).lower() if isinstance(given, dict) else ""
  for name in ("relu", "tanh"):
    if name in said:
      return name
  if said:
    raise UnreadableFile(f"{where}: activation {said} cannot be read; train with ReLU or Tanh")
  return "tanh" if kind == "on-policy" else "relu"


def _algorithm(data: Mapping[str, Any], kind: str, tensors: Mapping[str, Any]) -> str:
  """Name of the algorithm, from what only it has."""
  if kind == "on-policy":
    return "ppo" if "clip_range" in data else "a2c"
  if kind == "sac":
    return "sac"
  return "td3" if any(name.startswith("critic.qf1.") for name in tensors) else "ddpg"


def _count(data: Mapping[str, Any], name: str) -> int | None:
  value = data.get(name)
  return value if isinstance(value, int) else None
