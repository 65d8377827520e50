"""The catalogue of mechanisms: every file of this folder that defines one is in it, and every file a user adds."""

import difflib
import functools
import importlib
import importlib.util
import pkgutil
import sys
import zlib
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from qcar_twin.twin.mechanisms.base import SUBSYSTEMS, Mechanism

_added: list[Path] = []  # files a user named, for the life of the process


def catalogue() -> dict[str, Mechanism]:
  """All mechanisms by name: of this folder's files in alphabetical order, then of the files added.

  Raises:
    ValueError: two mechanisms share a name, or a parameter name is used twice.
  """
  return dict(_catalogue(tuple(_added)))


def add_file(path: str | Path) -> tuple[str, ...]:
  """Add the mechanisms of a Python file outside this package, for the life of the process.

  The file is run, so name only what you wrote or read. Nothing else runs one: a twin file names mechanisms and brings
  none.

  Args:
    path: file with at least one subclass of Mechanism.

  Returns:
    their names.

  Raises:
    FileNotFoundError: no such file.
    ValueError: it defines no mechanism, or one whose name or parameters are taken.
  """
  source = Path(path).resolve()
  if not source.is_file():
    raise FileNotFoundError(f"{path}: no such file; name the Python file that defines the mechanism")
  if source not in _added:
    _catalogue((*_added, source))  # refuses what does not fit
    _added.append(source)
  return tuple(m.name for m in _defined(_run(source)))


def offered(drive: str) -> tuple[Mechanism, ...]:
  """Every mechanism of the catalogue that a car with this kind of drive command can have and a diagnosis can name."""
  return tuple(m for m in catalogue().values() if drive in m.drives and not m.curve)


def curves(drive: str) -> tuple[Mechanism, ...]:
  """Every curve of no known form that a car with this kind of drive command can have."""
  return tuple(m for m in catalogue().values() if drive in m.drives and m.curve)


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
      cure = "one of your own is added with --mechanism-files FILE.py, in Python with mechanisms.add_file"
      raise KeyError(f"no mechanism '{name}'; did you mean {', '.join(near)}? {cure}")
    chosen.append(known[name])
  return tuple(chosen)


def by_subsystem(mechanisms: Iterable[Mechanism]) -> list[Mechanism]:
  """The same, in the order of SUBSYSTEMS and by name within each."""
  return sorted(mechanisms, key=lambda m: (SUBSYSTEMS.index(m.subsystem), m.name))


@functools.cache
def _catalogue(files: tuple[Path, ...]) -> dict[str, Mechanism]:
  mechanisms: dict[str, Mechanism] = {}
  owner: dict[str, str] = {}
  own = sorted(m.name for m in pkgutil.iter_modules(__path__) if m.name not in ("base", "by_motion"))
  for module in [*(importlib.import_module(f"{__name__}.{name}") for name in own), *map(_run, files)]:
    where = Path(str(module.__file__)).name
    for item in _defined(module):
      if item.name in mechanisms:
        raise ValueError(f"mechanism '{item.name}' is defined twice: once more in {where}; give it another name")
      mechanisms[item.name] = item()
      for parameter in item.parameters:
        if owner.setdefault(parameter.name, item.name) != item.name:
          raise ValueError(
            f"{where}: parameter '{parameter.name}' of {item.name} belongs to {owner[parameter.name]};"
            " give it another name"
          )
  return mechanisms


def _defined(module: ModuleType) -> list[type[Mechanism]]:
  """Mechanisms that a module defines itself."""
  items = [item for item in vars(module).values() if isinstance(item, type) and issubclass(item, Mechanism)]
  return [item for item in items if item.__module__ == module.__name__]


@functools.cache
def _run(source: Path) -> ModuleType:
  """A user's file, run once as a module."""
  # files of one name may lie in several folders
  name = f"mechanism_file_{source.stem}_{zlib.crc32(bytes(source)):08x}"
  spec = importlib.util.spec_from_file_location(name, source)
  if spec is None or spec.loader is None:
    raise ValueError(f"{source}: not a Python file; a mechanism is defined in a file that ends in .py")
  module = importlib.util.module_from_spec(spec)
  sys.modules[name] = module
  spec.loader.exec_module(module)
  if not _defined(module):
    raise ValueError(f"{source}: defines no mechanism; see docs/guide/extending.md for what one is")
  return module
