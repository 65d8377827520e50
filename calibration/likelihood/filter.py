"""The Kalman filter of filter.c: builds it on first use, and a smoother for what pushed the car.

Equations: docs/likelihood.md. `python -m calibration.likelihood.filter` builds it beforehand.
"""

import ctypes
import dataclasses
import functools
import hashlib
import platform
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qcar_twin import native
from qcar_twin.twin.engines.reduced.build import processor

Array = NDArray[np.float64]

SOURCE = Path(__file__).with_name("filter.c")
_FLAGS = ("-std=gnu11", *native.FLAGS)
_TUNED, _PLAIN = ("-march=native",), ()  # no operation is contracted or reordered: the bits are the same


@dataclasses.dataclass(frozen=True)
class Chain:
  """A linear-Gaussian model of J windows; n states, of which 7 are motions at a window's start and 3 are forces.

  Attributes:
    slopes: of the compressed readings over the states, (J, n, n).
    transition: of a window's end over its start and the forces, (J, 7, 10).
    begins: whether a window begins a chain, (J,).
    memory: share of every other state that is left after a window, (n - 7,).
    leak: variance that each motion gains per window, (7,); prior: of a chain's first start, (7,).
  """

  slopes: Array
  transition: Array
  begins: NDArray[np.bool_]
  memory: Array
  leak: Array
  prior: Array


@dataclasses.dataclass(frozen=True)
class Filtered:
  """Means (J, n) and covariances (J, n, n) of the states before and after each window's readings."""

  before: Array
  before_covariance: Array
  after: Array
  after_covariance: Array


def whiten(
  chain: Chain, readings: Array, gaps: Array, first: Array, keep: bool = False
) -> tuple[Array, float, Filtered | None]:
  """Innovations of a residual and of columns, (J, n, p), in units of their standard deviations.

  Args:
    readings: compressed, unit noise, (J, n, p); the first column is the residual.
    gaps: what each column adds to the next start, (J, 7, p).
    first: mean of a chain's first start, (J, 7); only rows that begin one count.
    keep: whether to keep the states of the residual for `smooth`.

  Returns:
    innovations; half the log determinant of their covariance (inf where it is not positive definite); states or None.
  """
  count, size, columns = readings.shape
  out = np.array(readings, dtype=np.float64, order="C")
  room, arrays = np.empty((2 * size, columns)), [_contiguous(a) for a in (chain.slopes, chain.transition, gaps)]
  small = [_contiguous(a) for a in (chain.memory, chain.leak, chain.prior, first)]
  begins = np.ascontiguousarray(chain.begins, dtype=np.uint8)
  shapes = [(count, size), (count, size, size)] * 2
  kept = [np.empty(shape) for shape in shapes] if keep else [None] * 4
  pointer = lambda a: None if a is None else a.ctypes.data
  half = _library().whiten(
    count, size, 7, 3, columns, arrays[0].ctypes.data, out.ctypes.data, arrays[1].ctypes.data, arrays[2].ctypes.data,
    begins.ctypes.data, *(a.ctypes.data for a in small), *map(pointer, kept), room.ctypes.data,
  )  # fmt: skip
  states = Filtered(kept[2], kept[3], kept[0], kept[1]) if keep else None  # type: ignore[arg-type]
  return out, half if np.isfinite(half) else np.inf, states


def smooth(chain: Chain, states: Filtered) -> Array:
  """Means of the states given all readings, (J, n): Rauch, Tung and Striebel, AIAA Journal 3(8), 1965."""
  out, size = states.after.copy(), states.after.shape[1]
  arrays = [_contiguous(a) for a in (chain.transition, chain.memory)]
  begins = np.ascontiguousarray(chain.begins, dtype=np.uint8)
  _library().smooth(
    len(out), size, 7, 3, arrays[0].ctypes.data, begins.ctypes.data, arrays[1].ctypes.data, out.ctypes.data,
    states.after_covariance.ctypes.data, states.before.ctypes.data, states.before_covariance.ctypes.data,
  )  # fmt: skip
  return out


def _contiguous(values: Array) -> Array:
  return np.ascontiguousarray(values, dtype=np.float64)


@functools.cache
def _library() -> ctypes.CDLL:
  library = ctypes.CDLL(str(build()))
  whole, array = ctypes.c_long, ctypes.c_void_p
  library.whiten.argtypes = [whole] * 5 + [array] * 14
  library.whiten.restype = ctypes.c_double
  library.smooth.argtypes = [whole] * 4 + [array] * 7
  library.smooth.restype = None
  return library


def build() -> Path:
  """The library, built if it is not there yet.

  Raises:
    BuildError: there is no compiler, or every compiler failed.
  """
  key = hashlib.sha256(SOURCE.read_bytes() + " ".join(_FLAGS).encode() + processor().encode()).hexdigest()[:12]
  target = native.place_for(SOURCE, f"filter-{platform.machine().lower()}-{key}{native.SUFFIX}")
  if not target.exists():
    make = lambda c, tuning: functools.partial(native.compile_library, c, (*_FLAGS, *tuning), SOURCE, target, {})
    attempts = [make(compiler, tuning) for compiler in native.compilers() for tuning in (_TUNED, _PLAIN)]
    native.first_success(attempts, "the filter", "calibration.likelihood.filter")
  return target


if __name__ == "__main__":
  print(build().name)
