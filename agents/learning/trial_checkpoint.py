"""What a training by reward needs to go on after it was stopped: stable-baselines3's zip, arrays, JSON.

The zip holds networks and optimisers; replay buffer, normaliser and random states are in arrays.npz and
checkpoint.json. Of the zip only the tensors are read, with torch's `weights_only`: nothing is unpickled. What the cars
are doing is in none of them: at every checkpoint all begin anew, with seeds that follow from the training's seed and
step, in a training that goes on as in one that is resumed. So both end in the same weights.
"""

import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from agents.learning.checkpoint import ARRAYS, POINTER
from agents.learning.sb3_zip import tensors_in
from qcar_twin.atomic_io import whole_folder, write_text
from qcar_twin.extras import extra
from qcar_twin.untrusted import UnreadableFile, bounded_memory, inside, read_json

with extra("Training"):
  import torch
  from stable_baselines3.common.base_class import BaseAlgorithm
  from stable_baselines3.common.vec_env import VecNormalize

MODEL, STATE = "model.zip", "arrays.npz"
_RETURNS = "returns"  # mean, variance and count of what the normaliser has seen


def save_checkpoint(agent: BaseAlgorithm, folder: Path, progress: dict[str, Any]) -> None:
  """Write the agent next to the old checkpoint, then point to the new one.

  Args:
    folder: of the training.  progress: of the training, kept as JSON.
  """
  name = f"checkpoint_{agent.num_timesteps}"
  key, words, *rest = np.random.get_state(legacy=True)
  arrays: dict[str, Any] = {"random_words": words, "torch_random": torch.get_rng_state().numpy()}
  buffer, env = getattr(agent, "replay_buffer", None), agent.get_vec_normalize_env()
  if buffer is not None:
    filled = buffer.buffer_size if buffer.full else buffer.pos
    arrays |= {array: getattr(buffer, array)[:filled] for array in ARRAYS if hasattr(buffer, array)}
  if env is not None:
    arrays[_RETURNS] = np.array([env.ret_rms.mean, env.ret_rms.var, env.ret_rms.count])
  with whole_folder(folder / name) as part:
    agent.save(part / MODEL)
    np.savez(part / STATE, **arrays)
  state = {
    "folder": name,
    "steps": agent.num_timesteps,
    "updates": agent._n_updates,  # type: ignore[attr-defined]
    "episodes": agent._episode_num,
    "buffer": None if buffer is None else [buffer.pos, buffer.full],
    "random": [key, *rest],
    "action_random": agent.action_space.np_random.bit_generator.state,
    "progress": progress,
  }
  write_text(folder / POINTER, json.dumps(state, indent=1) + "\n")
  for old in folder.glob("checkpoint_*"):
    if old.name != name:
      shutil.rmtree(old)


def load_checkpoint(agent: BaseAlgorithm, folder: Path) -> dict[str, Any]:
  """Put a fresh agent into the state of the last checkpoint; returns the training's progress.

  Raises:
    UnreadableFile: it is no checkpoint of such a training.
  """
  state = read_json(folder / POINTER)
  source = inside(folder, str(state.get("folder")))
  try:
    _networks(agent, source / MODEL)
    with np.load(source / STATE, allow_pickle=False) as arrays:
      _arrays(agent, state, arrays)
    agent.num_timesteps, agent._episode_num = int(state["steps"]), int(state["episodes"])
    agent._n_updates = int(state["updates"])  # type: ignore[attr-defined]
    return dict(state["progress"])
  except (KeyError, TypeError, IndexError, ValueError, OSError, RuntimeError, zipfile.BadZipFile) as error:
    raise UnreadableFile(f"{source}: is no checkpoint of this training ({error}); start in another folder") from error


def begin_anew(agent: BaseAlgorithm, seed: int) -> None:
  """Let all cars of the agent's environment begin again, with seeds that follow from the training's and its step."""
  env = agent.get_env()
  assert env is not None
  words = np.random.SeedSequence([seed, agent.num_timesteps]).generate_state(1, np.uint64)
  env.seed(int(words[0] >> np.uint64(2)))
  agent._last_obs = env.reset()  # type: ignore[assignment]
  agent._last_episode_starts = np.ones(env.num_envs, dtype=bool)
  if isinstance(env, VecNormalize):
    agent._last_original_obs = env.get_original_obs()  # type: ignore[assignment]
  if agent.action_noise is not None:
    agent.action_noise.reset()


def _networks(agent: BaseAlgorithm, file: Path) -> None:
  """Tensors of networks and optimisers, and what else of torch the algorithm saves, such as SAC's temperature."""
  names, others = agent._get_torch_save_params()
  read: dict[str, Any] = {}
  with zipfile.ZipFile(file) as archive, bounded_memory(file.stat().st_size):
    for name in [*names, "pytorch_variables"] if others else names:
      read[name] = tensors_in(archive, f"{name}.pth")
  rest = read.pop("pytorch_variables", {})
  agent.set_parameters(read, exact_match=True, device=agent.device)
  for name in others:
    getattr(agent, name).data = rest[name].data


def _arrays(agent: BaseAlgorithm, state: dict[str, Any], arrays: Any) -> None:
  """Replay buffer, normaliser and random states."""
  buffer, env = getattr(agent, "replay_buffer", None), agent.get_vec_normalize_env()
  if buffer is not None:
    buffer.pos, buffer.full = int(state["buffer"][0]), bool(state["buffer"][1])
    for array in (array for array in ARRAYS if hasattr(buffer, array)):
      target, kept = getattr(buffer, array), arrays[array]
      if kept.shape[1:] != target.shape[1:] or len(kept) > len(target):
        raise ValueError(f"buffer of {kept.shape}, this training has {target.shape}")
      target[: len(kept)] = kept
  if env is not None:
    env.ret_rms.mean, env.ret_rms.var = arrays[_RETURNS][0], arrays[_RETURNS][1]
    env.ret_rms.count = float(arrays[_RETURNS][2])
  key, *rest = state["random"]
  np.random.set_state((key, arrays["random_words"], *rest))
  torch.set_rng_state(torch.from_numpy(arrays["torch_random"]))
  agent.action_space.np_random.bit_generator.state = state["action_random"]
