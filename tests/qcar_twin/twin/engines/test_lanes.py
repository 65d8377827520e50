"""The functions of lanes.h are those of the C library, to the digits its comments promise, wherever a step asks."""

import ctypes

import numpy as np
import pytest

from qcar_twin import native
from qcar_twin.twin.engines.reduced import build

# name: the range a simulation step may ask for, numpy's function, error
FUNCTIONS = {
  "sine": ((0.0, np.pi), np.sin, 1e-13),
  "arctangent": ((0.0, 1e4), np.arctan, 1e-13),
  "exponential": ((-700.0, 700.0), np.exp, 1e-13),
  "logarithm": ((1e-8, 1e8), np.log, 1e-13),
  "root": ((0.0, 1e8), np.sqrt, 1e-15),
}


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> ctypes.CDLL:
  folder = tmp_path_factory.mktemp("lanes")
  source = folder / "lanes.c"
  body = "for (long i = 0; i < n; i += LANES) store(y + i, %s(load(x + i)));"
  text = "\n".join(f"void {f}_of(const double* x, double* y, long n) {{ {body % f} }}" for f in FUNCTIONS)
  source.write_text('#include "lanes.h"\n' + text + "\n")
  target = folder / f"lanes{native.SUFFIX}"
  flags = ("-std=gnu11", "-Wno-psabi", *native.FLAGS, f"-I{build.SOURCE.parent}")
  native.compile_library(native.compilers()[0], flags, source, target, {})
  return ctypes.CDLL(str(target))


def values(between: tuple[float, float]) -> np.ndarray:
  """Evenly spread ones, and ones spread over the orders of magnitude, down to the range's lower end."""
  low, high = between
  even = np.linspace(low, high, 40_000)
  near = low + (high - low) * np.logspace(-12, 0, 40_000)
  return np.ascontiguousarray(np.concatenate([even, np.minimum(near, high)]))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_it_is_the_c_librarys_function(library, name):
  between, expected, error = FUNCTIONS[name]
  x = values(between)
  y = np.empty_like(x)
  function = getattr(library, f"{name}_of")
  function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long]
  function(x.ctypes.data, y.ctypes.data, len(x))
  wrong = np.abs(y - expected(x)) / np.maximum(np.abs(expected(x)), 1.0)
  assert wrong.max() < error, (name, float(x[np.argmax(wrong)]))
