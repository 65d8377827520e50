"""A physics digital twin of a 1:10 robotic car in MuJoCo.

  from qcar_twin import DataSet, Twin, Bicycle

Each name is imported when it is first asked for, so that recordings can be read without a simulator.
"""

from importlib import import_module
from typing import Any

_ROOMS = {
  "Bicycle": "bicycle",
  "DataSet": "recordings",
  "Recording": "recordings",
  "RecordingError": "recordings",
  "Twin": "twin",
  "Vehicle": "vehicle",
  "load_twin": "twin",
  "save_twin": "twin",
}
__all__ = list(_ROOMS)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
  if name not in _ROOMS:
    raise AttributeError(f"qcar_twin has no '{name}'; it offers {', '.join(__all__)}")
  return getattr(import_module(f"qcar_twin.{_ROOMS[name]}"), name)
