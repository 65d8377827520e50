"""The catalogue of mechanisms: every file of this folder that defines one is in it."""

import difflib
import functools
import importlib
import pkgutil
from collections.abc import Iterable

from qcar_twin.mechanisms.base import Mechanism


@functools.cache
def catalogue() -> dict[str, Mechanism]:
  """All mechanisms by name, found by scanning this folder; adding a file is all it takes.

  Raises:
    ValueError: two mechanisms share a name, or a parameter name is used twice.
  """
  found: dict[str, Mechanism] = {}
  owner: dict[str, str] = {}
  for module in sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name != "base"):
    for item in vars(importlib.import_module(f"{__name__}.{module}")).values():
      if isinstance(item, type) and issubclass(item, Mechanism) and item.__module__.endswith("." + module):
        if item.name in found:
          raise ValueError(f"mechanism '{item.name}' is defined twice: once more in {module}.py")
        found[item.name] = item()
        for parameter in item.parameters:
          if owner.setdefault(parameter.name, item.name) != item.name:
            raise ValueError(f"parameter '{parameter.name}' belongs to {owner[parameter.name]} and {item.name}")
  return found


def select(names: Iterable[str]) -> tuple[Mechanism, ...]:
  """Mechanisms by name.

  Raises:
    KeyError: unknown name, with the nearest known ones.
  """
  known = catalogue()
  chosen = []
  for name in names:
    if name not in known:
      near = difflib.get_close_matches(name, known, n=3) or sorted(known)
      raise KeyError(f"no mechanism '{name}'; did you mean {', '.join(near)}?")
    chosen.append(known[name])
  return tuple(chosen)
