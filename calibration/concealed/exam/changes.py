"""Changes of a generator's own parameters by name; "tyre_front.mu_y0" is a parameter of one of its parts."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

Change = Callable[[Any, float, bool], None]


def scale(*names: str) -> Change:
  """Multiply parameters by 1 + size."""

  def act(p: Any, size: float, later: bool) -> None:
    for name in names:
      owner, last = _found(p, name)
      setattr(owner, last, getattr(owner, last) * (1.0 + size))

  return act


def divide(*names: str, late: bool = False) -> Change:
  """Divide them by 1 + size; `late`: only in the second half of a session."""

  def act(p: Any, size: float, later: bool) -> None:
    if later or not late:
      scale(*names)(p, 1.0 / (1.0 + size) - 1.0, later)

  return act


def add(*names: str) -> Change:
  """Add the size to them."""

  def act(p: Any, size: float, later: bool) -> None:
    for name in names:
      owner, last = _found(p, name)
      setattr(owner, last, getattr(owner, last) + size)

  return act


def _found(p: Any, name: str) -> tuple[Any, str]:
  """The object that holds a parameter, and the parameter's own name."""
  *owners, last = name.split(".")
  return reduce(getattr, owners, p), last
