"""The task on every path as dm_control environments by name; apart, because dm_control looks for a screen on import."""

from functools import partial

from agents.learning.environments import Options, fleet
from qcar_twin.envs.dm_env import Suite
from qcar_twin.envs.fleet import Fleet
from qcar_twin.paths import PATHS


def suite() -> Suite:
  """Environments `path_tracking_s` and so on."""
  return Suite({f"path_tracking_{path}": partial(_on_path, path) for path in PATHS})


def _on_path(path: str, seed: int) -> Fleet:
  return fleet(Options(path=path), [seed])
