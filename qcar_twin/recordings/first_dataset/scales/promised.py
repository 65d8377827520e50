"""Units that the type of a message promises and its driver need not keep: a VESC's publishes deg/s and g as an Imu of
ROS, whose are rad/s and m/s^2. They are tested as those of any column whose name says none."""

from __future__ import annotations

from collections.abc import Mapping

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, scale
from qcar_twin.recordings.first_dataset.mount import settle_gravity
from qcar_twin.recordings.first_dataset.refine import settle_units


def settle_promised(
  columns: Columns, guesses: dict[str, Guess], vehicle: Mapping[str, float | str]
) -> dict[str, Guess]:
  """Scale the sensors that a map takes at their word where no car reaches what they say, where gravity is not in their
  unit, or another sensor shows the same motion in another one. Returns the guesses that moved."""
  before = {name: guess.scale for name, guess in guesses.items()}
  for guess in guesses.values():
    limit = CHANNELS[guess.channel].limit
    if CHANNELS[guess.channel].kind == "sensor" and guess.scale == 1.0 and columns.top(guess.column) > limit:
      by_size = Guess(guess.channel, guess.column)
      scale(columns, by_size)
      guess.scale = by_size.scale
      guess.why += by_size.why
  settle_gravity(columns, guesses)
  settle_units(columns, guesses, vehicle)
  return {name: guess for name, guess in guesses.items() if guess.scale != before[name]}
