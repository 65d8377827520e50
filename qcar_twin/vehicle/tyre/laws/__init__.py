"""The tyre laws: every file here that has a C function next to it is one.

A law `x` is `x.py`, which declares its own parameters as PARAMETERS, and `x.h`, which defines

    static inline mjtNum x_secant(const mjtNum* u, mjtNum rho)

the force over that of a tyre that stays linear, at a linear force `rho` in units of mu F_z: 1 at rho = 0, and
rho g(rho) <= 1, since the friction cone stands outside the tyre's own peak. `u` are the wheel's parameters, at the
upper-case names of COLUMN. It may also have `slip_over_linear`, its inverse, from which a car that begins in mid-drive
has its slip; without it that is a linear tyre's.
"""

import functools
import importlib
import pkgutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import Parameter

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent
DEFAULT = "sine"


@functools.cache
def tyre_laws() -> Mapping[str, tuple[Parameter, ...]]:
  """Law -> its own parameters; the default first, the others by name.

  Raises:
    ValueError: a law lacks its C function, or two laws share a parameter's name.
  """
  laws: dict[str, tuple[Parameter, ...]] = {}
  for name in sorted((m.name for m in pkgutil.iter_modules(__path__)), key=lambda n: (n != DEFAULT, n)):
    header = FOLDER / f"{name}.h"
    if not header.is_file() or f"{name}_secant(" not in header.read_text(encoding="utf-8"):
      raise ValueError(f"tyre law '{name}': laws/{name}.h does not define {name}_secant; see docs/guide/extending.md")
    laws[name] = tuple(importlib.import_module(f"{__name__}.{name}").PARAMETERS)
  names = [p.name for parameters in laws.values() for p in parameters]
  if len(set(names)) != len(names):
    twice = next(n for n in names if names.count(n) > 1)
    raise ValueError(f"two tyre laws have a parameter '{twice}'; give one of them another name")
  return laws


def law_parameters(law: str) -> tuple[Parameter, ...]:
  """A law's own parameters.

  Raises:
    ValueError: unknown law, with those there are.
  """
  if law not in tyre_laws():
    raise ValueError(f"no tyre law '{law}'; there are {', '.join(tyre_laws())}")
  return tyre_laws()[law]


def slip_over_linear(law: str) -> Callable[[Array, Mapping[str, Array]], Array]:
  """A law's steady slip over that of a linear tyre, given the used share of mu F_z, (N,), and parameters, (N,) each."""
  linear = lambda used, values: np.ones_like(used)
  return getattr(importlib.import_module(f"{__name__}.{law}"), "slip_over_linear", linear)
