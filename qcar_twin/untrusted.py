"""Files that somebody else wrote: read as data, of bounded size and memory, and only inside their own folder.

Whatever such a file holds, its reader ends in what it means or in an error of one sentence. Damaged and hostile files
claim lengths that they do not have, unpack to a thousand times their size, nest until the parser's stack is gone, or
name other files; none of that is looked for in each format, it is bounded here for all of them.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import stat
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from qcar_twin.extras import extra

try:
  import resource
except ImportError:  # Windows has no limits for a process
  resource = None

MOST_TEXT = 1 << 20  # bytes of a TOML file: thousands of recordings with a line on each
MOST_JSON = 64 << 20  # bytes of a JSON file that holds results
SPARE_MEMORY = 1 << 30  # bytes that reading may take whatever the file's size: packed doubles of a day at 100 Hz
GROWTH = 16  # bytes of memory per byte of the file, beyond that: text of two characters a cell becomes two doubles
DEEPEST = 64  # parts of a dotted key: a parser's time grows with their square
_QUOTED = re.compile(r"\"(?:\\.|[^\"\\\n])*+\"?|'[^'\n]*+'?")
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{DEEPEST}}}")


class UnreadableFile(ValueError):
  """A file that is not what it should be; the text names the file, what is wrong with it and the cure."""


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
  """A TOML file. Raises UnreadableFile (what is wrong, where), FileNotFoundError, OSError."""
  text = read_text(path)
  name = Path(path).name
  if deep := _LONG_KEY.search(plain := _QUOTED.sub("q", text)):
    where = f"near line {plain.count(chr(10), 0, deep.start()) + 1}"
    raise UnreadableFile(f"{name}: is not usable TOML (a key of more than {DEEPEST} parts {where}); shorten it")
  return _parsed(name, "TOML", tomllib.loads, text)


def read_yaml(path: str | os.PathLike[str]) -> dict[str, Any]:
  """A YAML file that holds a table of plain values. Raises UnreadableFile (what is wrong, where), FileNotFoundError."""
  with extra("Reading YAML"):
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.events import AliasEvent

  name, text = Path(path).name, read_text(path)
  try:
    if any(isinstance(event, AliasEvent) for event in YAML(typ="safe", pure=True).parse(text)):
      raise UnreadableFile(f"{name}: has an alias (*name), and files with those grow without bound; write it out")
    content = _parsed(name, "YAML", YAML(typ="safe", pure=True).load, text)
  except (YAMLError, RecursionError) as error:
    said = " ".join(str(error).split())
    raise UnreadableFile(f"{name}: is not usable YAML ({said}); correct that line") from error
  if not isinstance(content, dict):
    raise UnreadableFile(f"{name}: holds no table, but {type(content).__name__}; write it again")
  return content


def read_json(path: str | os.PathLike[str], most: int = MOST_JSON) -> dict[str, Any]:
  """A JSON file that holds an object. Raises UnreadableFile (what is wrong, where), FileNotFoundError, OSError."""
  content = _parsed(Path(path).name, "JSON", json.loads, read_text(path, most))
  if not isinstance(content, dict):
    raise UnreadableFile(f"{Path(path).name}: holds no JSON object, but {type(content).__name__}; write it again")
  return content


def read_text(path: str | os.PathLike[str], most: int = MOST_TEXT) -> str:
  """A text file in UTF-8, with or without a byte order mark, of at most so many bytes."""
  path = Path(path)
  require_file(path, most)
  try:
    return path.read_bytes().decode("utf-8-sig")
  except UnicodeDecodeError as error:
    raise UnreadableFile(f"{path.name}: is not UTF-8 text ({error}); save it as UTF-8") from error


def require_file(path: Path, most: int | None = None) -> None:
  """Raises FileNotFoundError where there is nothing; UnreadableFile for what is no file, or larger than it may be."""
  status = path.stat()
  if not stat.S_ISREG(status.st_mode):
    raise UnreadableFile(f"{path}: is not a file; give the path of a file")
  if most is not None and status.st_size > most:
    raise UnreadableFile(
      f"{path.name}: has {status.st_size / 2**20:.0f} MiB, and nothing of its kind has more than {most / 2**20:.0f};"
      " give the file that was meant"
    )


def inside(folder: str | os.PathLike[str], name: str) -> Path:
  """The path that a file in `folder` names, relative to it.

  Raises UnreadableFile for a path that leads out of the folder: absolute, over `..`, or through a link.
  """
  if "\0" in name:
    raise UnreadableFile(f"{name!r} cannot be the name of a file; correct it")
  home = Path(folder).resolve()
  try:
    target = (home / _in_this_locale(name)).resolve()
    target.exists()
  except (OSError, RuntimeError) as error:  # a link to itself, a name too long
    raise UnreadableFile(f"'{name[:200]}' cannot be found ({error}); correct the name") from error
  if not target.is_relative_to(home):
    raise UnreadableFile(
      f"'{name}' lies outside {Path(folder)}, and files of a folder may only name what is in it; copy that file there"
    )
  return target


def _in_this_locale(name: str) -> str:
  """A file's name that a text has, as paths have it: in a POSIX locale those are bytes, whatever they mean."""
  if sys.getfilesystemencoding() == "utf-8":
    return name
  return os.fsdecode(name.encode("utf-8", "surrogateescape"))


def memory_for(size: int) -> int:
  """Bytes that reading a file of `size` bytes may take."""
  return SPARE_MEMORY + GROWTH * size


@contextlib.contextmanager
def bounded_memory(size: int) -> Iterator[None]:
  """While the block runs the process may take what a file of `size` bytes may, on top of what it has; beyond that every
  allocation fails (MemoryError, or what a library makes of it).

  Address space is what is bounded; systems that do not bound it (macOS, Windows) are left as they are.
  """
  in_use = _address_space()
  if resource is None or in_use is None:
    yield
    return
  soft, hard = resource.getrlimit(resource.RLIMIT_AS)
  allowed = in_use + memory_for(size)
  limits = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
  resource.setrlimit(resource.RLIMIT_AS, (min([allowed, *limits]), hard))
  try:
    yield
  finally:
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def is_number(value: object, infinite: bool = False) -> bool:
  """Whether a parsed value is a number, no truth value and no NaN; finite, unless it may be `infinite`."""
  if isinstance(value, bool) or not isinstance(value, (int, float, np.floating, np.integer)):
    return False
  try:
    number = float(value)
  except OverflowError:  # an integer of hundreds of digits
    return False
  return math.isfinite(number) or (infinite and math.isinf(number))


def _address_space() -> int | None:
  """Bytes of address space that this process has in use; None where the system does not say."""
  try:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
  except (OSError, ValueError, IndexError):
    return None
  return pages * os.sysconf("SC_PAGE_SIZE")


def _parsed(name: str, kind: str, parse: Any, text: str) -> Any:
  try:
    return parse(text)
  except RecursionError as error:
    raise UnreadableFile(f"{name}: is not valid {kind} (brackets nest too deep); correct it") from error
  except ValueError as error:  # syntax, and integers of more digits than Python reads
    raise UnreadableFile(f"{name}: is not valid {kind} ({error}); correct that line") from error
