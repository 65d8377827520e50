"""Everything a training needs to go on after it was killed, as data: tensors, arrays and JSON.

A checkpoint is a folder of its own; `checkpoint.json` names the valid one and is replaced in one go, so a kill at
any instant leaves either the old or the new checkpoint.
"""

import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from agents.learning.ddpg import Agent
from qcar_twin.atomic_io import whole_folder, write_text
from qcar_twin.extras import extra
from qcar_twin.untrusted import UnreadableFile, inside, read_json

with extra("Training"):
  import torch
  from safetensors import SafetensorError
  from safetensors.torch import load_file, save_file

POINTER = "checkpoint.json"
ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def save_checkpoint(agent: Agent, folder: Path, progress: dict[str, Any]) -> None:
  """Write networks, optimisers, buffer and random states next to the old checkpoint, then point to the new one.

  Args:
    folder: of the training.
    progress: of the training, kept as JSON.
  """
  name = f"checkpoint_{agent.num_timesteps}"
  with whole_folder(folder / name) as part:
    _write(agent, part)
  buffer = agent.replay_buffer
  assert buffer is not None
  key, _, *rest = np.random.get_state()
  state = {
    "folder": name,
    "num_timesteps": agent.num_timesteps,
    "updates": agent._n_updates,
    "episodes": agent._episode_num,
    "done": agent.done,
    "buffer": {"pos": buffer.pos, "full": buffer.full},
    "random": [key, *rest],
    "progress": progress,
  }
  write_text(folder / POINTER, json.dumps(state, indent=1) + "\n")
  for old in folder.glob("checkpoint_*"):
    if old.name != name:
      shutil.rmtree(old)


def _write(agent: Agent, folder: Path) -> None:
  """Networks, optimisers, buffer and random words as files."""
  save_file(_tensors(agent), folder / "networks.safetensors")
  buffer = agent.replay_buffer
  assert buffer is not None
  filled = buffer.buffer_size if buffer.full else buffer.pos
  np.savez(
    folder / "arrays.npz",
    random_words=np.random.get_state(legacy=True)[1],  # pyright: ignore[reportArgumentType]
    torch_random=torch.get_rng_state().numpy(),
    **{array: getattr(buffer, array)[:filled] for array in ARRAYS},
  )


def load_checkpoint(agent: Agent, folder: Path) -> dict[str, Any]:
  """Put a fresh agent into the state of the last checkpoint; returns the training's progress.

  Raises:
    FileNotFoundError: there is no checkpoint, with the cure.
    ValueError: it belongs to an agent of another shape.
  """
  if not (folder / POINTER).is_file():
    raise FileNotFoundError(f"{folder / POINTER}: no checkpoint to resume from; start without --resume")
  state = read_json(folder / POINTER)
  source = inside(folder, str(state.get("folder")))
  try:
    return _go_on(agent, state, source)
  except (KeyError, TypeError, IndexError, RuntimeError, SafetensorError, zipfile.BadZipFile) as error:
    raise UnreadableFile(f"{source}: is no checkpoint of this training ({error}); start in another folder") from error


def _go_on(agent: Agent, state: dict[str, Any], source: Path) -> dict[str, Any]:
  _restore(agent, load_file(source / "networks.safetensors"))
  buffer = agent.replay_buffer
  assert buffer is not None
  with np.load(source / "arrays.npz", allow_pickle=False) as arrays:
    for array in ARRAYS:
      target = getattr(buffer, array)
      if arrays[array].shape[1:] != target.shape[1:] or len(arrays[array]) > len(target):
        raise ValueError(f"{source}: buffer of {arrays[array].shape}, this training has {target.shape}")
      target[: len(arrays[array])] = arrays[array]
    key, *rest = state["random"]
    np.random.set_state((key, arrays["random_words"], *rest))
    torch.set_rng_state(torch.from_numpy(arrays["torch_random"]))
  buffer.pos, buffer.full = state["buffer"]["pos"], state["buffer"]["full"]
  agent.num_timesteps, agent._n_updates = state["num_timesteps"], state["updates"]
  agent._episode_num = state["episodes"]
  agent.advance(state["done"])
  return state["progress"]


def _tensors(agent: Agent) -> dict[str, torch.Tensor]:
  tensors = {f"policy/{name}": value.contiguous() for name, value in agent.policy.state_dict().items()}
  for which, optimizer in _optimizers(agent).items():
    for index, entry in optimizer.state_dict()["state"].items():
      tensors |= {f"{which}/{index}/{name}": value.contiguous() for name, value in entry.items()}
  return tensors


def _restore(agent: Agent, tensors: dict[str, torch.Tensor]) -> None:
  weights = {name.removeprefix("policy/"): value for name, value in tensors.items() if name.startswith("policy/")}
  agent.policy.load_state_dict(weights)
  for which, optimizer in _optimizers(agent).items():
    entries: dict[int, dict[str, torch.Tensor]] = {}
    for name, value in tensors.items():
      owner, index, *rest = name.split("/")
      if owner == which:
        entries.setdefault(int(index), {})[rest[0]] = value
    optimizer.load_state_dict({"state": entries, "param_groups": optimizer.state_dict()["param_groups"]})


def _optimizers(agent: Agent) -> dict[str, torch.optim.Optimizer]:
  return {"actor_optimizer": agent.actor.optimizer, "critic_optimizer": agent.critic.optimizer}
