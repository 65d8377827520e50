"""Builds the C parts with the compiler that is there, once per source, and keeps the library.

Compilers are tried in this order: $CC, cc, gcc, clang, then `ziglang`. A library lies in `_build/` beside its source,
or in the user's cache where that cannot be written; its name is keyed by what it was made from, so a stale one is never
loaded.
"""

import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

SUFFIX = {"Darwin": ".dylib", "Windows": ".dll"}.get(platform.system(), ".so")
# no contraction of a*b+c: the same bits from every compiler
FLAGS = ("-O3", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared")


class BuildError(RuntimeError):
  """A C part could not be built; the message says what was tried and what to do."""


def compilers() -> list[list[str]]:
  """Compiler commands to try, best first."""
  found = [shlex.split(os.environ["CC"])] if os.environ.get("CC") else []
  found += [[path] for name in ("cc", "gcc", "clang") if (path := shutil.which(name))]
  if importlib.util.find_spec("ziglang"):
    found.append([sys.executable, "-m", "ziglang", "cc"])
  return found


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
    written: texts of headers that are made for the occasion, by name.
    libraries: to link with.

  Raises:
    BuildError: the compiler failed; its output is in the message.
  """
  target.parent.mkdir(parents=True, exist_ok=True)
  with tempfile.TemporaryDirectory(dir=target.parent) as folder:
    fresh = Path(folder) / target.name
    for name, text in written.items():
      (Path(folder) / name).write_text(text, encoding="utf-8")
    linked = [str(path) for path in libraries]
    command = [*compiler, *flags, f"-I{folder}", str(source), "-o", str(fresh), *linked, "-lm"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
      raise BuildError(f"{' '.join(compiler)} failed:\n{(result.stderr or result.stdout).strip()[-2000:]}")
    fresh.replace(target)


def first_success(attempts: Sequence[Callable[[], None]], what: str, module: str) -> None:
  """Try one after the other until one builds.

  Raises:
    BuildError: every attempt failed, or there was none.
  """
  failures = []
  for attempt in attempts:
    try:
      attempt()
      return
    except (BuildError, OSError) as error:
      failures.append(str(error))
  tried = "\n".join(failures) or "no compiler was found"
  raise BuildError(
    f"cannot build {what}: {tried}\ninstall a C compiler, or `pip install ziglang`, and run `python -m {module}`"
  )


def place_for(source: Path, name: str) -> Path:
  """`_build/` beside the source where the library is or can be written, else `qcar_twin` in the user's cache."""
  beside = source.parent / "_build"
  if (beside / name).exists():
    return beside / name
  try:
    beside.mkdir(exist_ok=True)
    with tempfile.TemporaryFile(dir=beside):
      return beside / name
  except OSError:  # as in an installation that belongs to somebody else
    cache = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (cache if cache.is_absolute() else Path.home() / ".cache") / "qcar_twin" / name
