"""Changes of a generator's own parameters by name; "tyre_front.mu_y0" is a parameter of one of its parts."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

Change = Callable[[Any, float, bool], None]


def scale(*names: str, late: bool = False) -> Change:
  """Multiply parameters by 1 + size; `late`: only in the second half of a session."""

  def act(p: Any, size: float, later: bool) -> None:
    for name in names if later or not late else ():
      owner, last = _found(p, name)
      setattr(owner, last, getattr(owner, last) * (1.0 + size))

  return act


def divide(*names: str, late: bool = False) -> Change:
  """Divide them by 1 + size; `late`, as of `scale`."""
  change = scale(*names, late=late)
  return lambda p, size, later: change(p, 1.0 / (1.0 + size) - 1.0, later)


def add(*names: str) -> Change:
  """Add the size to them."""

  def act(p: Any, size: float, later: bool) -> None:
    for name in names:
      owner, last = _found(p, name)
      setattr(owner, last, getattr(owner, last) + size)

  return act


def move(more: str, less: str) -> Change:
  """Add the size to one and take it from another."""

  def act(p: Any, size: float, later: bool) -> None:
    add(more)(p, size, later)
    add(less)(p, -size, later)

  return act


def _found(p: Any, name: str) -> tuple[Any, str]:
  """The object that holds a parameter, and the parameter's own name."""
  *owners, last = name.split(".")
  return reduce(getattr, owners, p), last
