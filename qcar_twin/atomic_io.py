"""Files that appear whole or not at all, whatever stops the writer."""

import contextlib
import errno
import functools
import json
import math
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

_HIDDEN = ".writing-"
_ROOM = 1 << 14  # bytes
_REFUSED = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM)
_COMPUTER = re.sub(r"[^A-Za-z0-9.]", "_", platform.node()) or "here"


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
  """A place to write to that becomes `path` when the block ends; after an error nothing has changed there.

  The place has the name of `path`, so that writers that go by the ending work. It lies in a hidden folder next to that
  path, so that it is on the same disk and no listing of the folder finds it. The folder of `path` is made.
  """
  path = Path(path)
  path.parent.mkdir(parents=True, exist_ok=True)
  with staging(path.parent) as folder:
    part = folder / path.name
    yield part
    part.replace(path)


@contextlib.contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
  """An empty folder to write to that becomes `path`, in place of what is there, when the block ends; what was there
  stays after an error."""
  path = Path(path)
  path.parent.mkdir(parents=True, exist_ok=True)
  with staging(path.parent) as folder:
    part = folder / path.name
    part.mkdir()
    yield part
    replaced = path.rename(folder / "replaced") if path.exists() else None
    try:
      part.rename(path)
    except OSError:
      if replaced is not None:
        replaced.rename(path)
      raise


@contextlib.contextmanager
def staging(place: Path) -> Iterator[Path]:
  """A hidden folder in `place` for what is being written; it is gone afterwards.

  What a writer that was killed left behind goes, too: its name says on which computer and in which process it ran.
  """
  with naming(place):
    _sweep(place.resolve())
    with tempfile.TemporaryDirectory(prefix=f"{_HIDDEN}{_COMPUTER}-{os.getpid()}-", dir=place) as folder, naming(place):
      yield Path(folder)


@contextlib.contextmanager
def naming(place: str | os.PathLike[str]) -> Iterator[None]:
  """Errors of a disk that is full or may not be written to become OSErrors that name the place.

  Libraries that write in C say so in errors of their own, or only that something they wrote to has gone.
  """
  try:
    yield
  except Exception as error:
    if isinstance(error, OSError) and error.errno in _REFUSED:
      raise OSError(error.errno, os.strerror(error.errno), os.fspath(place)) from error
    for code in (errno.ENOSPC, errno.EFBIG):
      if os.strerror(code) in str(error) or (code == errno.ENOSPC and _full(Path(place))):
        raise OSError(code, os.strerror(code), os.fspath(place)) from error
    raise


def _full(place: Path) -> bool:
  """Whether there is no room left for a small file."""
  try:
    return shutil.disk_usage(place).free < _ROOM
  except OSError:
    return False


@functools.cache
def _sweep(place: Path) -> None:
  """Remove what dead processes of this computer were writing in a folder; looked for once per process."""
  for left in place.glob(f"{_HIDDEN}{_COMPUTER}-*"):
    process = left.name.split("-")[-2]
    if process.isdecimal() and not _runs(int(process)):
      shutil.rmtree(left, ignore_errors=True)


def _runs(process: int) -> bool:
  """Whether a process of this computer is there; True where nobody can say."""
  if os.name != "posix":
    return True
  try:
    os.kill(process, 0)
  except ProcessLookupError:
    return False
  except OSError:  # somebody else's
    return True
  return True


def write_text(path: str | os.PathLike[str], text: str) -> Path:
  """Write a text file in UTF-8, line ends as they are; returns its path."""
  with whole_file(path) as part:
    part.write_text(text, encoding="utf-8", newline="")
  return Path(path)


def write_json(path: str | os.PathLike[str], data: Any) -> Path:
  """Write data as JSON, see `plain`; returns the file's path."""
  return write_text(path, json.dumps(plain(data), indent=1, allow_nan=False, ensure_ascii=False) + "\n")


def plain(value: Any) -> Any:
  """Nested data as JSON has them: numpy's scalars and arrays converted, paths as text, None for what is not finite."""
  if isinstance(value, Mapping):
    return {str(key): plain(item) for key, item in value.items()}
  if isinstance(value, (list, tuple, np.ndarray)):
    return [plain(item) for item in value]
  if isinstance(value, (bool, np.bool_)):
    return bool(value)
  if isinstance(value, (int, np.integer)):
    return int(value)
  if isinstance(value, (float, np.floating)):
    return float(value) if math.isfinite(value) else None
  return os.fspath(value) if isinstance(value, os.PathLike) else value
