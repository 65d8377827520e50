"""The axes of one sensor have one unit: what tells that of one axis tells that of the others."""

from collections.abc import Mapping

from qcar_twin.recordings.first_dataset.columns import Guess
from qcar_twin.recordings.unit_names import words_of


def axes_of_one(name: str, other: str) -> bool:
  """Whether two columns' names differ in the axis alone: `imu/acl_x` and `imu/acl_y`, `accX` and `accY`."""
  pairs = list(zip(words_of(name), words_of(other), strict=False))
  odd = [(a, b) for a, b in pairs if a != b]
  if len(words_of(name)) != len(words_of(other)) or len(odd) != 1:
    return False
  a, b = odd[0]
  return a[:-1] == b[:-1] and {a[-1], b[-1]} <= set("xyz")


def other_axes(guesses: Mapping[str, Guess], channel: str) -> list[str]:
  """The channels that are other axes of a channel's sensor and were read in the same unit as it so far; none of those
  whose column names its unit."""
  own = guesses[channel]
  return [
    name
    for name, guess in guesses.items()
    if name != channel and not guess.named and guess.scale == own.scale and axes_of_one(own.column, guess.column)
  ]
