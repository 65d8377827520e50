"""Builds the tyre plugin from tyre.c and the laws: `python -m qcar_twin.vehicle.tyre.build`, or on first use.

The library lies in `_build/` beside this file, or in the user's cache where that cannot be written, its name
keyed by MuJoCo's version and the sources, so a stale one is never loaded. Compilers are tried in this order:
$CC, cc, gcc, clang, then `ziglang`.
"""

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import mujoco

from qcar_twin.vehicle.tyre.laws import FOLDER, tyre_laws
from qcar_twin.vehicle.tyre.parameters import header

SOURCE = Path(__file__).with_name("tyre.c")
SUPPORTED = "3.17."  # the plugin writes constraint rows whose layout belongs to this version
_SUFFIX = {"Darwin": ".dylib", "Windows": ".dll"}.get(platform.system(), ".so")
# no contraction of a*b+c: the same bits from every compiler
_FLAGS = ("-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared")


class BuildError(RuntimeError):
  """The tyre plugin could not be built; the message says what was tried and what to do."""


def library_path() -> Path:
  """Where the library for this MuJoCo and these sources belongs: see `_folder_for`."""
  laws = b"".join((FOLDER / f"{law}.h").read_bytes() for law in tyre_laws())
  key = hashlib.sha256(SOURCE.read_bytes() + laws + header().encode() + " ".join(_FLAGS).encode()).hexdigest()[:12]
  machine = platform.machine().lower()
  name = f"qcar_tyre-{mujoco.__version__}-{machine}-{key}{_SUFFIX}"
  return _folder_for(name) / name


def compilers() -> list[list[str]]:
  """Compiler commands to try, best first."""
  found = [shlex.split(os.environ["CC"])] if os.environ.get("CC") else []
  found += [[path] for name in ("cc", "gcc", "clang") if (path := shutil.which(name))]
  if importlib.util.find_spec("ziglang"):
    found.append([sys.executable, "-m", "ziglang", "cc"])
  return found


def compile_plugin(compiler: Sequence[str], target: Path) -> None:
  """Compile tyre.c and the laws with one compiler; the library appears complete or not at all.

  Raises:
    BuildError: the compiler failed; its output is in the message.
  """
  target.parent.mkdir(parents=True, exist_ok=True)
  with tempfile.TemporaryDirectory(dir=target.parent) as folder:
    fresh = Path(folder) / target.name
    (Path(folder) / "laws.h").write_text(header(), encoding="utf-8")
    searched = [f"-I{path}" for path in (Path(mujoco.HEADERS_DIR).parent, folder, FOLDER)]
    command = [*compiler, *_FLAGS, *searched, str(SOURCE), "-o", str(fresh), str(_libmujoco()), "-lm"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
      raise BuildError(f"{' '.join(compiler)} failed:\n{(result.stderr or result.stdout).strip()[-2000:]}")
    fresh.replace(target)


def build(force: bool = False) -> Path:
  """The plugin's library, built if it is not there yet.

  Raises:
    BuildError: MuJoCo is another version, there is no compiler, or every compiler failed.
  """
  if not mujoco.__version__.startswith(SUPPORTED):
    raise BuildError(
      f"the tyre plugin is written for MuJoCo {SUPPORTED}x and this is {mujoco.__version__};"
      f" install 'mujoco=={SUPPORTED}*', or use tyre=\"native\""
    )
  target = library_path()
  if target.exists() and not force:
    return target
  failures = []
  for compiler in compilers():
    try:
      compile_plugin(compiler, target)
      return target
    except (BuildError, OSError) as error:
      failures.append(str(error))
  tried = "\n".join(failures) or "no compiler was found"
  raise BuildError(
    f"cannot build the tyre plugin: {tried}\ninstall a C compiler, or `pip install ziglang`, and run"
    " `python -m qcar_twin.vehicle.tyre.build`"
  )


def _folder_for(name: str) -> Path:
  """`_build/` beside the source where the library is or can be written, else `qcar_twin` in the user's cache."""
  beside = SOURCE.parent / "_build"
  if (beside / name).exists():
    return beside
  try:
    beside.mkdir(exist_ok=True)
    with tempfile.TemporaryFile(dir=beside):
      return beside
  except OSError:  # as in an installation that belongs to somebody else
    cache = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (cache if cache.is_absolute() else Path.home() / ".cache") / "qcar_twin"


def _libmujoco() -> Path:
  """The engine's shared library, shipped beside its Python package."""
  folder = Path(str(mujoco.__file__)).parent
  candidates = sorted(folder.glob("libmujoco*.so*")) + sorted(folder.glob("libmujoco*.dylib"))
  candidates += sorted(folder.glob("mujoco.lib"))
  if not candidates:
    raise BuildError(f"no MuJoCo library in the package '{folder.name}'; reinstall mujoco {mujoco.__version__}")
  return candidates[0]


if __name__ == "__main__":
  print(build(force="--force" in sys.argv[1:]).name)
