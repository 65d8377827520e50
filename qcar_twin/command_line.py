"""How a command is run: its options read, and what went wrong said in a sentence that names a cure.

A command is a module with a docstring, a dataclass `Config` and a function `main(config)`. What a stopped run has
written is looked up; where one can go on from it, `KEPT` is a sentence that says how. Where --out is a file and no
folder, `OUT_IS_FILE` is True, or says it of the options. `POSITIVE` names numbers that may not be zero.
"""

import codecs
import dataclasses
import errno
import io
import itertools
import logging
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

from qcar_twin.cures import RENAMED_OPTIONS, RENAMED_PLANTS, cure

PACKAGES = ("qcar_twin", "calibration", "agents", "scripts")
FILES = "mechanism_files"
FILES_HELP = "Python files with mechanisms of your own, which are executed: read them first (docs/guide/extending.md)."
FAILED, MISUSED, INTERRUPTED = 1, 2, 130  # exit codes; the last is the shell's for Ctrl-C
WRITTEN = ("out", "record", "folder", "work", "page", "archive", "truth_out")  # options that name what is written
_LISTED = 3  # files that are named


def sentence(error: Exception) -> str | None:
  """What to tell the user, None where the error is none of the input but a fault of the program.

  Input: files, values, unknown names (a KeyError with a sentence), missing packages, errors of this project's kinds.
  """
  if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] not in PACKAGES:
    return f"this needs the package '{(error.name or '').partition('.')[0]}', which is not installed"
  if isinstance(error, KeyError) and error.args and " " in str(error.args[0]):
    return str(error.args[0])
  own = isinstance(error, ValueError) or type(error).__module__.partition(".")[0] in PACKAGES
  return cure(error) or (str(error) if own else None)


def let_every_character_through() -> None:
  """Make the terminal take what a verdict says: a POSIX locale's knows ASCII only, others may lack a sign."""
  for stream in (sys.stdout, sys.stderr):
    if isinstance(stream, io.TextIOWrapper):
      known = codecs.lookup(stream.encoding).name
      if known == "ascii":  # its names of files are bytes, too
        stream.reconfigure(encoding="utf-8", errors="surrogateescape")
      elif known != "utf-8":
        stream.reconfigure(errors="replace")


def run(name: str, load: Callable[[], ModuleType], arguments: Sequence[str], traceback: bool = False) -> int:
  """Run the command that `load` imports under a name; returns the exit code. With `traceback` errors are raised."""
  module: ModuleType | None = None
  config: object = None
  begun = time.time()
  let_every_character_through()
  logging.basicConfig(level=logging.WARNING, format="%(message)s")
  try:
    module = load()
    refuse_renamed(module.Config, arguments)
    files, config = parsed(module.Config, arguments, name, module.__doc__)
    for file in files:
      from qcar_twin.twin.mechanisms import add_file

      add_file(file)
    _quiet_mujoco()
    is_file = getattr(module, "OUT_IS_FILE", False)
    refuse_early(config, bool(is_file(config) if callable(is_file) else is_file), getattr(module, "POSITIVE", ()))
    module.main(config)
  except KeyboardInterrupt:
    print(f"\n{name}: stopped; {left_by(config, begun, getattr(module, 'KEPT', ''))}", file=sys.stderr)
    return INTERRUPTED
  except Exception as error:
    said = None if isinstance(error, BrokenPipeError) else sentence(error)
    if traceback or said is None:
      raise
    print(f"{name}: {said}", file=sys.stderr)
    return FAILED
  return 0


def left_by(config: object, begun: float, go_on: str = "") -> str:
  """What a run that began then, s since 1970, has written where its options say, and how to go on from it."""
  places = [place for place in (getattr(config, name, None) for name in WRITTEN) if isinstance(place, Path)]
  files = itertools.chain.from_iterable(place.rglob("*") if place.is_dir() else [place] for place in places)
  made = sorted({os.fspath(file) for file in files if file.is_file() and _changed(file) >= begun})
  if not made:
    return go_on or "nothing of this run is kept: results are written at its end"
  more = f" and {len(made) - _LISTED} more" if len(made) > _LISTED else ""
  said = f"written so far: {', '.join(made[:_LISTED])}{more}"
  return f"{said}; {go_on}" if go_on else said


def _changed(file: Path) -> float:
  """When a file was written or put in its place, s since 1970: what is copied with its times has the older one."""
  stat = file.stat()
  return max(stat.st_mtime, stat.st_ctime)


def parsed(config: type, arguments: Sequence[str], name: str, text: str | None = None) -> tuple[tuple[Path, ...], Any]:
  """The files of `--mechanism-files`, which every command has, since any may read a twin file that names a mechanism of
  the user's own, and the command's own options. Raises SystemExit as argparse does."""
  import tyro  # here, because the list of commands needs nothing but the standard library

  files = (FILES, Annotated[tuple[Path, ...], tyro.conf.arg(help=FILES_HELP)], ())
  every = dataclasses.make_dataclass("Config", [files], bases=(config,), frozen=True)
  given = tyro.cli(every, prog=name, description=text, args=list(arguments))
  own = {f.name: getattr(given, f.name) for f in dataclasses.fields(config)}
  return getattr(given, FILES), config(**own)


def refuse_renamed(config: type, arguments: Sequence[str]) -> None:
  """Raises ValueError where an argument is a word of an earlier version, with the one that took its place."""
  fields, option = {field.name for field in dataclasses.fields(config)}, ""
  for argument in arguments:
    if argument == "--":  # what follows is a script's own
      return
    if argument.startswith("--"):
      option, _, argument = argument.partition("=")
      new = RENAMED_OPTIONS.get(option, "")
      if new and new.strip("-").replace("-", "_") in fields:
        raise ValueError(f"{option} is called {new} now")
    if option in ("--plant", "--plants") and argument in RENAMED_PLANTS:
      raise ValueError(f"{option} {argument} is called {option} {RENAMED_PLANTS[argument]} now")


def _quiet_mujoco() -> None:
  """MuJoCo's warnings go to the log: by itself it prints them, and leaves a file where a command is run."""
  if "mujoco" in sys.modules:
    import mujoco

    mujoco.set_mju_user_warning(lambda text: logging.getLogger("qcar_twin").debug("MuJoCo: %s", text))


def refuse_early(config: object, out_is_file: bool = False, positive: Sequence[str] = ()) -> None:
  """Refuse, before any work, what a command would stumble over at its end: numbers that are none, negative counts, and
  by the names that options have everywhere `out`, `record` or `folder` that cannot be written, `add_mechanisms` or
  `candidates` that nobody knows, a `twin` that is no twin file.

  Raises:
    OSError, KeyError, ValueError: with the path or the name, and a cure.
  """
  _require_numbers(config, positive)
  out = getattr(config, "out", None)
  if isinstance(out, Path):
    _require_writable(out, out_is_file)
  for made in (getattr(config, name, None) for name in ("folder", "record")):
    if isinstance(made, Path):
      _require_writable(made, False)
  if names := (*getattr(config, "add_mechanisms", ()), *getattr(config, "candidates", ())):
    from qcar_twin.twin.mechanisms import select

    select(names)
  twin = getattr(config, "twin", None)
  if isinstance(twin, str | Path) and str(twin):
    from qcar_twin.twin.file import load_twin

    load_twin(twin, threads=1)


def _require_numbers(config: object, positive: Sequence[str]) -> None:
  """Raises ValueError where a number of an option is not finite, or negative where its default is a size or a count: a
  positive number, or a whole one from 0 on."""
  for field in dataclasses.fields(config) if dataclasses.is_dataclass(config) else ():
    option, given = f"--{field.name.replace('_', '-')}", getattr(config, field.name)
    for value in given if isinstance(given, tuple) else (given,):
      if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{option} {value}: give a finite number")
      usual = field.default
      size = isinstance(usual, int | float) and (usual > 0 or (usual == 0 and isinstance(usual, int)))
      if size and isinstance(value, int | float) and value < 0:
        raise ValueError(f"{option} {value}: give 0 or more")
      if field.name in positive and value <= 0:
        raise ValueError(f"{option} {value}: give more than 0")


def _require_writable(out: Path, is_file: bool) -> None:
  """Raises OSError where a folder, or the folder of a file, cannot be made or written in; leaves nothing behind."""
  if is_file and out.is_dir():
    raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(out))
  folder = out.absolute().parent if is_file else out.absolute()
  nearest = next(path for path in (folder, *folder.parents) if path.exists())
  if not nearest.is_dir():
    raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(nearest))
  try:
    with tempfile.TemporaryDirectory(dir=nearest):  # a folder, since some places take files and no folders
      pass
  except OSError as error:
    said = error.strerror
    if error.errno == errno.ENOENT:  # of a place that the system makes itself, as /proc
      said = f"cannot be made, as {nearest} takes no folders; name another folder"
    raise type(error)(error.errno, said, str(folder)) from error


def run_script() -> None:
  """Run the file that Python was started with as the command it is; ends the process with its exit code."""
  module = sys.modules["__main__"]
  raise SystemExit(run(Path(str(module.__file__)).name, lambda: module, sys.argv[1:]))
