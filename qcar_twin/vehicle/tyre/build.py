"""Builds the tyre plugin from tyre.c and the laws: `python -m qcar_twin.vehicle.tyre.build`, or on first use.

See qcar_twin/native.py; the library's name is keyed by MuJoCo's version and the sources.
"""

import functools
import hashlib
import platform
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco

from qcar_twin import native
from qcar_twin.native import BuildError, compilers
from qcar_twin.vehicle.tyre.laws import FOLDER, tyre_laws
from qcar_twin.vehicle.tyre.parameters import header

SOURCE = Path(__file__).with_name("tyre.c")
SUPPORTED = "3.17."  # the plugin writes constraint rows whose layout belongs to this version
_FLAGS = ("-std=c11", *native.FLAGS)


def library_path() -> Path:
  """Where the library for this MuJoCo and these sources belongs: see `native.place_for`."""
  laws = b"".join((FOLDER / f"{law}.h").read_bytes() for law in tyre_laws())
  key = hashlib.sha256(SOURCE.read_bytes() + laws + header().encode() + " ".join(_FLAGS).encode()).hexdigest()[:12]
  machine = platform.machine().lower()
  return native.place_for(SOURCE, f"qcar_tyre-{mujoco.__version__}-{machine}-{key}{native.SUFFIX}")


def compile_plugin(compiler: Sequence[str], target: Path) -> None:
  """Compile tyre.c and the laws with one compiler; the library appears complete or not at all.

  Raises:
    BuildError: the compiler failed; its output is in the message.
  """
  flags = (*_FLAGS, f"-I{Path(mujoco.HEADERS_DIR).parent}", f"-I{FOLDER}")
  native.compile_library(compiler, flags, SOURCE, target, {"laws.h": header()}, [_libmujoco()])


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
  if force or not target.exists():
    attempts = [functools.partial(compile_plugin, compiler, target) for compiler in compilers()]
    native.first_success(attempts, "the tyre plugin", "qcar_twin.vehicle.tyre.build")
  return target


def _libmujoco() -> Path:
  """The engine's shared library, shipped with its Python package."""
  folder = Path(str(mujoco.__file__)).parent
  candidates = sorted(folder.glob("libmujoco*.so*")) + sorted(folder.glob("libmujoco*.dylib"))
  candidates += sorted(folder.glob("mujoco.lib"))
  if not candidates:
    raise BuildError(f"no MuJoCo library in the package '{folder.name}'; reinstall mujoco {mujoco.__version__}")
  return candidates[0]


if __name__ == "__main__":
  print(build(force="--force" in sys.argv[1:]).name)
