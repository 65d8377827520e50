"""A critic that sees the truth: actor and critic of an on-policy algorithm look at different numbers.

What a step was worth is judged in training alone, where the simulator knows where the car is and how its linkage is
bent. A critic that knows it can part luck from skill; the actor sees what a car sees, and is all that is kept (Pinto
et al., Asymmetric actor critic for image-based robot learning, Robotics: Science and Systems, 2018).
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.learning.observation import STEERING_SCALE, ObservationSpec
from qcar_twin.envs.driven_cars import TRUE
from qcar_twin.envs.fleet import Fleet
from qcar_twin.envs.task import ERROR_SCALE
from qcar_twin.extras import extra
from qcar_twin.plant import signal_index

with extra("Training"):
  import torch
  from stable_baselines3.common.policies import ActorCriticPolicy
  from stable_baselines3.common.torch_layers import MlpExtractor

Array = NDArray[np.float64]
CRITICS = ("own", "truth")
"""Whose eyes the critic has: the actor's own, or those of the simulator besides."""
HIDDEN = ("velocity_y", "steering_angle")  # of the true signals
HIDDEN_SCALE = (5.0, STEERING_SCALE)  # s/m, 1/rad: of order one
LINKAGE_SCALE = (10.0, 40.0)  # -, 1/rad: the half-widths that training draws from become 1


@dataclasses.dataclass(frozen=True)
class TruthBesides:
  """What an actor sees, and after it what only the simulator knows: the four true errors, the velocity across, m/s,
  the steering angle, rad, the linkage's gain less 1, and its offset, rad.

  Attributes:
    seen: by the actor.
  """

  seen: ObservationSpec

  @property
  def size(self) -> int:
    """Numbers per car."""
    return len(self.scale) + len(ERROR_SCALE)

  @property
  def scale(self) -> tuple[float, ...]:
    """Of the numbers beyond the four errors."""
    return (*self.seen.scale, *ERROR_SCALE, *HIDDEN_SCALE, *LINKAGE_SCALE)

  def of(self, fleet: Fleet) -> Array:
    """What is seen, (N, size), in SI units."""
    errors = np.nan_to_num(fleet.errors.observation[TRUE])
    hidden = np.nan_to_num(fleet.signals[:, [signal_index(name) for name in HIDDEN]])
    linkage = np.stack([fleet.linkage.gain - 1.0, fleet.linkage.offset], axis=-1)
    return np.concatenate([self.seen.of(fleet), errors, hidden, linkage], axis=1)


class _Apart(MlpExtractor):
  """Two networks without a common layer, of which the actor's sees the first numbers alone."""

  def __init__(self, count: int, seen: int, arch: Any, activation: type[torch.nn.Module], device: torch.device):
    super().__init__(count, arch, activation, device)
    self.policy_net = MlpExtractor(seen, arch, activation, device).policy_net
    self._seen = seen

  def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
    return self.policy_net(features[:, : self._seen])


class SeeingCriticPolicy(ActorCriticPolicy):
  """An MlpPolicy whose actor sees the first `seen` numbers of an observation, its critic all."""

  def __init__(self, observation_space: Any, action_space: Any, lr_schedule: Callable[[float], float], **given: Any):
    self._seen = int(given.pop("seen"))
    super().__init__(observation_space, action_space, lr_schedule, **given)

  def _build_mlp_extractor(self) -> None:
    self.mlp_extractor = _Apart(self.features_dim, self._seen, self.net_arch, self.activation_fn, self.device)
