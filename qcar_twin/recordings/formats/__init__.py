"""Files that logs come in: each reader turns one file into a `Table` of named columns.

A module of this folder (or of one added to `__path__`) that reads files says so: `READERS = {".npz": "read_npz"}`, a
suffix and the function for it, in a package with its module, `"samples.read_text"`. It is imported when such a file is
read, so recordings need none of its libraries.
"""

from __future__ import annotations

import ast
import functools
import os
import pkgutil
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

from qcar_twin.extras import MissingExtra
from qcar_twin.recordings.formats.composed import composed
from qcar_twin.recordings.formats.folder import read_folder, tables_in
from qcar_twin.recordings.formats.table import NoSamples, SeveralRecordings, Table
from qcar_twin.recordings.formats.text.long import spread
from qcar_twin.recordings.formats.unsigned import signed
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.untrusted import UnreadableFile, bounded_memory, inside

# pyarrow's usual pool reserves 1 GiB of address space at its first use, which is all that a file may take
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")

PACKED = (".gz", ".zip", ".bz2", ".xz", ".zst", ".7z", ".rar", ".tar", ".tgz")  # files that hold files
BAG_FOLDER = ".db3"  # what a folder is read as: a ROS 2 bag


def readers() -> dict[str, tuple[str, str]]:
  """Suffix -> module and function that reads such files, as the modules declare them."""
  declared: dict[str, tuple[str, str]] = {}
  for module in pkgutil.iter_modules(__path__):
    folder = Path(str(getattr(module.module_finder, "path", "")))
    path = folder / module.name / "__init__.py" if module.ispkg else folder / f"{module.name}.py"
    for suffix, function in _declared(path).items():
      declared[suffix] = (module.name, function)
  return declared


def _declared(path: Path) -> Mapping[str, str]:
  """What READERS says in a source file, read without importing it."""
  return _said(path, path.stat().st_mtime_ns) if path.is_file() else {}


@functools.cache
def _said(path: Path, _written: int) -> Mapping[str, str]:
  """The same of a file as it was last written."""
  for node in ast.parse(path.read_text(encoding="utf-8")).body:
    if isinstance(node, ast.Assign) and [getattr(target, "id", "") for target in node.targets] == ["READERS"]:
      return ast.literal_eval(node.value)
  return {}


def _reader(path: Path, label: str) -> Callable[[Path, str], Table]:
  if path.is_dir() and tables_in(path):
    return lambda folder, name: read_folder(folder, name, _read)
  suffix, known = BAG_FOLDER if path.is_dir() else path.suffix.lower(), readers()
  if suffix in PACKED:
    raise RecordingError(f"{label}: is packed; unpack it first, and name what comes out")
  if suffix not in known:
    listed = ", ".join(sorted(known, key=lambda each: each != ".csv"))  # the usual one first
    raise RecordingError(
      f"{label}: cannot read '{path.suffix}' files; readable are: {listed}, ROS 2 bag folders and folders of"
      " tables, one per topic; export it as one of them"
    )
  module, function = known[suffix]
  inner, _, name = function.rpartition(".")
  try:
    return getattr(import_module(".".join(filter(None, (__name__, module, inner)))), name)
  except MissingExtra as error:
    raise RecordingError(f"{label}: {error}") from error


def read_table(path: Path, label: str | None = None) -> Table:
  """Read one log file; `label` is its name in errors. Raises RecordingError: missing, unreadable, empty, broken;
  SeveralRecordings, with a table of each, where it holds more than one."""
  try:
    return composed(signed(_read(path, label or path.name)))
  except SeveralRecordings as error:
    raise SeveralRecordings(
      error.label, {name: composed(signed(table)) for name, table in error.tables.items()}
    ) from None


def _read(path: Path, label: str) -> Table:
  """The same, of the file's own columns alone."""
  try:
    size = _size(path, label)
  except UnreadableFile as error:  # a bag's part that is a link to elsewhere
    raise RecordingError(f"{label}: {error}") from error
  read = _reader(path, label)
  try:
    with bounded_memory(size):
      table = spread(read(path, label))
  except SeveralRecordings:
    raise
  except RecordingError as error:  # what a library says takes several lines at times
    kind = NoSamples if isinstance(error, NoSamples) else RecordingError
    raise kind(" ".join(str(error).split())) from error
  except MemoryError as error:
    raise RecordingError(_too_large(label, size)) from error
  except OSError as error:
    raise RecordingError(f"{label}: cannot be read ({error}); check the file and its permissions") from error
  except Exception as error:  # readers raise many kinds for damaged files
    said = " ".join(str(error).split())
    raise RecordingError(
      f"{label}: is damaged, or not the {path.suffix} file it is called ({said}); write it again"
    ) from error
  if table.rows == 0:
    raise NoSamples(f"{label}: has column names but no rows; record it again or remove it from dataset.toml")
  return table


def read_inside(folder: Path, file: str) -> Table:
  """The log that a data set names; it has to lie in the data set's folder, whatever links say."""
  try:
    return read_table(inside(folder, file), file)
  except UnreadableFile as error:
    raise RecordingError(str(error)) from error


def _size(path: Path, label: str) -> int:
  """Bytes of a file, or of all files of a folder; RecordingError where there are none."""
  if not path.exists():
    raise RecordingError(f"{label}: no such file in {path.parent}; check `file` in dataset.toml")
  if not path.is_file() and not path.is_dir():
    raise RecordingError(f"{label}: is neither a file nor a folder; check `file` in dataset.toml")
  parts = [path] if path.is_file() else [inside(path, part.name) for part in path.iterdir()]
  size = sum(part.stat().st_size for part in parts)
  if path.is_file() and size == 0:
    raise NoSamples(f"{label}: the file is empty (0 bytes); record it again or remove it from dataset.toml")
  return size


def _too_large(label: str, size: int) -> str:
  return (
    f"{label}: unpacks to far more than its {size} bytes can hold, so that its lengths are damaged or it is none of a"
    " car; write it again, a longer drive in several files"
  )


__all__ = ["Table", "read_inside", "read_table", "readers"]
