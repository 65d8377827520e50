"""Builds the C parts with the compiler that is there, once per source, and keeps the library.

Compilers are tried in this order: $CC, cc, gcc, clang, then `ziglang`. A library lies in the folder that the
environment variable QCAR_TWIN_CACHE names. Without it, the first of these that can be written takes the library:
`_build/` next to its source, the user's cache, a private folder among the temporary files. A library's name is keyed by
what it was made from, so a stale one is never loaded.
"""

import contextlib
import importlib.util
import os
import platform
import shlex
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

CACHE = "QCAR_TWIN_CACHE"  # environment variable that names the folder for compiled libraries
SUFFIX = {"Darwin": ".dylib", "Windows": ".dll"}.get(platform.system(), ".so")
# no contraction of a*b+c: the same bits from every compiler
FLAGS = ("-O3", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared")


class BuildError(RuntimeError):
  """A C part could not be built; the message says what was tried and what to do."""


class FolderError(BuildError):
  """No folder can take a compiled library; another compiler would not help."""

  def __init__(self, reason: str) -> None:
    super().__init__(
      f"the compiled parts have no folder to lie in: {reason};"
      f" set the environment variable {CACHE} to a folder that you may write to and that has room"
    )


def compilers() -> list[list[str]]:
  """Compiler commands to try, best first."""
  commands = [shlex.split(os.environ["CC"])] if os.environ.get("CC") else []
  commands += [[path] for name in ("cc", "gcc", "clang") if (path := shutil.which(name))]
  if importlib.util.find_spec("ziglang"):
    commands.append([sys.executable, "-m", "ziglang", "cc"])
  return commands


def compile_library(
  compiler: Sequence[str],
  flags: Sequence[str],
  source: Path,
  target: Path,
  written: Mapping[str, str],
  libraries: Sequence[Path] = (),
) -> None:
  """Compile one source; the library appears complete or not at all.

  Args:
    written: texts of headers that are made for this build, by name.
    libraries: to link with.

  Raises:
    BuildError: the compiler failed or could not be started; its output is in the message.
    FolderError: the folder of `target` can't be written.
  """
  try:
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
      fresh = Path(folder) / target.name
      for name, text in written.items():
        (Path(folder) / name).write_text(text, encoding="utf-8")
      linked = [str(path) for path in libraries]
      _run_compiler([*compiler, *flags, f"-I{folder}", str(source), "-o", str(fresh), *linked, "-lm"], compiler)
      fresh.replace(target)
  except OSError as error:
    raise FolderError(f"{target.parent} ({error.strerror or error})") from error


def _run_compiler(command: Sequence[str], compiler: Sequence[str]) -> None:
  """Run one compile command; raises BuildError where it can't be started or fails."""
  try:
    result = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
  except OSError as error:
    raise BuildError(f"{' '.join(compiler)} could not be started: {error.strerror or error}") from error
  if result.returncode:
    raise BuildError(f"{' '.join(compiler)} failed:\n{(result.stderr or result.stdout).strip()[-2000:]}")


def first_success(attempts: Sequence[Callable[[], None]], what: str, module: str) -> None:
  """Try one after the other until one builds.

  Raises:
    BuildError: every attempt failed, or there was none.
    FolderError: the library's folder can't be written.
  """
  failures = []
  for attempt in attempts:
    try:
      attempt()
      return
    except FolderError:
      raise
    except (BuildError, OSError) as error:
      failures.append(str(error))
  tried = "\n".join(failures) or "no compiler was found"
  raise BuildError(
    f"cannot build {what}: {tried}\ninstall a C compiler, or `pip install ziglang`, and run `python -m {module}`"
  )


def place_for(source: Path, name: str) -> Path:
  """Where a library is, or else where it can be written: see the module for the folders and their order.

  Raises:
    FolderError: none of the folders can be used.
  """
  refused = []
  for folder, private in _folders(source):
    reason = _obstacle(folder, name, private)
    if not reason:
      return folder / name
    refused.append(f"{folder} ({reason})")
  raise FolderError("; ".join(refused))


def _folders(source: Path) -> Iterator[tuple[Path, bool]]:
  """Folders for compiled libraries, best first, and whether one lies where other users may write."""
  if named := os.environ.get(CACHE):
    yield Path(named).absolute(), False
    return
  yield source.parent / "_build", False
  cache = Path(os.environ.get("XDG_CACHE_HOME", ""))
  with contextlib.suppress(RuntimeError):  # no HOME, and a user that the system does not know
    yield (cache if cache.is_absolute() else Path.home() / ".cache") / "qcar_twin", False
  with contextlib.suppress(FileNotFoundError):  # no temporary folder can be written
    yield Path(tempfile.gettempdir()) / f"qcar_twin-{_user()}", True


def _obstacle(folder: Path, name: str, private: bool) -> str:
  """Why a library can't be loaded from a folder or written to it, "" where it can; the folder is made.

  Loading a library runs its code, so a `private` folder must be this user's own and closed to others.
  """
  try:
    str(folder).encode("utf-8")  # MuJoCo takes a plugin's path as UTF-8
    folder.mkdir(mode=0o700 if private else 0o777, parents=True, exist_ok=True)
    status = folder.lstat()
    if private and hasattr(os, "geteuid") and not _own(status):
      return "it is not this user's alone"
    if not (folder / name).exists():
      with tempfile.TemporaryFile(dir=folder):
        pass
  except UnicodeEncodeError:
    return "this locale can't say its name in UTF-8"
  except OSError as error:
    return error.strerror or str(error)
  return ""


def _own(status: os.stat_result) -> bool:
  """Whether a path is a folder, no link, of this user, that nobody else may read or write."""
  return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & 0o077


def _user() -> str:
  """This user's number; the temporary folder of a system without such numbers is the user's own."""
  return str(os.geteuid()) if hasattr(os, "geteuid") else "user"
