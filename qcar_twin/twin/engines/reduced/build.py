"""Builds the reduced car from reduced_car.c: `python -m qcar_twin.twin.engines.reduced.build`, or on first use.

See qcar_twin/native.py. It is compiled for the processor it runs on, and plainly where the compiler can't; the bits are
the same, since no operation is contracted or reordered.
"""

import ctypes
import functools
import hashlib
import platform
import sys
from collections.abc import Sequence
from pathlib import Path

from qcar_twin import native
from qcar_twin.native import compilers
from qcar_twin.twin.engines.reduced.layout import header

SOURCE = Path(__file__).with_name("reduced_car.c")
_FLAGS = ("-std=gnu11", "-Wno-psabi", *native.FLAGS)
TUNED, PLAIN = ("-march=native",), ()


def library_path() -> Path:
  """Where the library for this processor and these sources belongs."""
  sources = SOURCE.read_bytes() + SOURCE.with_name("lanes.h").read_bytes() + header().encode()
  key = hashlib.sha256(sources + " ".join(_FLAGS).encode() + processor().encode()).hexdigest()[:12]
  return native.place_for(SOURCE, f"reduced_car-{platform.machine().lower()}-{key}{native.SUFFIX}")


def compile_car(compiler: Sequence[str], tuning: Sequence[str], target: Path) -> None:
  """Compile it with one compiler.

  Raises:
    BuildError: the compiler failed.
  """
  flags = (*_FLAGS, *tuning, f"-I{SOURCE.parent}")
  native.compile_library(compiler, flags, SOURCE, target, {"layout.h": header()})


def build(force: bool = False) -> Path:
  """The library, built if it is not there yet.

  Raises:
    BuildError: there is no compiler, or every compiler failed.
  """
  target = library_path()
  if force or not target.exists():
    attempts = [functools.partial(compile_car, c, tuning, target) for c in compilers() for tuning in (TUNED, PLAIN)]
    native.first_success(attempts, "the reduced car", "qcar_twin.twin.engines.reduced.build")
  return target


@functools.cache
def load() -> ctypes.CDLL:
  """The library, with the types of its functions' arguments."""
  library = ctypes.CDLL(str(build()))
  array, whole = ctypes.c_void_p, ctypes.c_long
  library.advance.argtypes = [array, array, array, whole, whole, array, array, array, ctypes.c_int, array, whole]
  library.drive.argtypes = [*[array] * 3, whole, whole, array, whole, *[array] * 4, ctypes.c_int, whole, whole]
  library.advance.restype = library.drive.restype = None
  library.lanes.argtypes, library.lanes.restype = [], whole
  return library


def processor() -> str:
  """What the processor can do, as far as the system says: a library made for one may not run on another."""
  try:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return next(line for line in lines if line.startswith(("flags", "Features")))
  except (OSError, StopIteration):
    return platform.processor()


if __name__ == "__main__":
  print(build(force="--force" in sys.argv[1:]).name)
