"""What a description of a car says of figures that it does not state."""

from collections.abc import Mapping
from typing import TypeVar

Figure = TypeVar("Figure")
MEANT: Mapping[str, str] = {"friction_load_exponent": "load_exponent"}
"""Figure -> the one that is meant for both where it is stated alone: one load exponent is of all a tyre's force."""


def with_meant(stated: Mapping[str, Figure], meant: Mapping[str, str] = MEANT) -> dict[str, Figure]:
  """Figures by name, with those that are meant by another one."""
  return {name: stated[other] for name, other in meant.items() if other in stated} | dict(stated)
