"""Which two of three position axes are the floor's: motion capture and game engines often count y upwards."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from qcar_twin.recordings.first_dataset.columns import Columns, Guess, scale
from qcar_twin.recordings.unit_names import words_of

_FLAT = 0.05  # of the way along either other axis: an axis that moves less is the upright one
# what turns about an axis is called so
_ABOUT_Y = {"yaw_rate": {"angular", "gyro", "gyr", "gyroscope"}, "pose_yaw": {"euler", "rotation", "rot"}}
_MOST = (1.0, 99.0)  # per cent of the samples, whose spread is the way


def settle_plane(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Where y is the axis that hardly moves, z and x are the floor's: of a right-handed frame z cross x is y, upwards."""
  if "pose_x" not in guesses:
    return
  axes = _axes(columns, guesses["pose_x"].column)
  if len(axes) < 3:
    return
  low, high = np.array([np.percentile(columns.values(axes[axis]), _MOST) for axis in "xyz"]).T
  x, y, z = high - low
  if not y < _FLAT * min(x, z):
    return
  for channel, axis in (("pose_x", "z"), ("pose_y", "x")):
    guesses[channel] = Guess(
      channel, axes[axis], why=[f"'{axes['y']}' hardly moves, so it points up, and {axis} lies flat"]
    )
    scale(columns, guesses[channel])
  for channel, kinds in _ABOUT_Y.items():
    turned = [name for name in columns.names if _about_y(name) & kinds and not columns.constant(name)]
    if len(turned) == 1 and (channel not in guesses or turned[0] in _turned_beside(columns, guesses[channel])):
      guesses[channel] = Guess(channel, turned[0], why=[f"'{axes['y']}' points up, and this turns about it"])
      scale(columns, guesses[channel])
      if channel == "yaw_rate":
        _settle_accelerometer(columns, guesses, axes["y"])


def _turned_beside(columns: Columns, guess: Guess) -> set[str]:
  """The other axes of the sensor of a turning that was taken about z, as its name says."""
  return set(_axes(columns, guess.column, "z").values()) - {guess.column}


def upright(columns: Columns, guesses: Mapping[str, Guess]) -> str:
  """The position axis that points up where it is called y, and the gyro, if there is one, has the same axes; else "".

  Motion capture counts to the left about it and engines as Unity to the right, and then all that turns is mirrored.
  """
  axes = _axes(columns, guesses["pose_x"].column, "z") if "pose_x" in guesses else {}
  gyro = guesses.get("yaw_rate")
  return axes.get("y", "") if axes and (gyro is None or _about_y(gyro.column)) else ""


def _settle_accelerometer(columns: Columns, guesses: dict[str, Guess], up: str) -> None:
  """An accelerometer whose axes are those of a gyro that turns about y feels forwards along z and sideways along x."""
  felt = guesses.get("accel_x") or guesses.get("accel_y")
  axes = _axes(columns, felt.column, "x" if felt.channel == "accel_x" else "y") if felt else {}
  if len(axes) < 3:
    return
  for channel, axis in (("accel_x", "z"), ("accel_y", "x")):
    guesses[channel] = Guess(
      channel, axes[axis], why=[f"'{up}' points up, and so does y of the gyro that goes with it"]
    )
    scale(columns, guesses[channel])


def _about_y(name: str) -> set[str]:
  """The words of a name that says axis y, without it."""
  words = words_of(name)
  return set(words) - {"y"} if words.count("y") == 1 else set()


def _axes(columns: Columns, name: str, own: str = "x") -> dict[str, str]:
  """The columns whose names differ from this one, which is of its `own` axis, in the axis alone."""
  words = words_of(name)
  place = next((k for k, word in enumerate(words) if word[-1] == own and len(word) <= 2), None)
  if place is None:
    return {}
  wanted = {axis: (*words[:place], words[place][:-1] + axis, *words[place + 1 :]) for axis in "xyz"}
  return {axis: other for axis, want in wanted.items() for other in columns.names if words_of(other) == want}


def without_half_a_place(guesses: dict[str, Guess]) -> dict[str, Guess]:
  """The guesses without pose_x or pose_y where the other is absent: half a place says nothing."""
  half = len(guesses.keys() & {"pose_x", "pose_y"}) == 1
  return {channel: guess for channel, guess in guesses.items() if not half or channel not in ("pose_x", "pose_y")}
