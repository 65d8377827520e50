"""The speed of an axle, of its two wheels: their mean is that of the axle's middle, whatever the car turns by.

With track b and yaw rate r the wheels go with v - r b / 2 and v + r b / 2.
"""

from collections.abc import Iterable

import numpy as np

from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import COMMANDED, words_of

_REAR = (("rl", "rr"), ("lr", "rr"), ("lb", "rb"), ("bl", "br"), ("hl", "hr"))  # whose wheels are not steered, first
_SIDES = (*_REAR, ("left", "right"), ("l", "r"), ("fl", "fr"), ("lf", "rf"), ("vl", "vr"), ("g", "d"))
# a wheel's place in a name; "hinten" and "vorne" are rear and front
SIDES = {"fl", "fr", "rl", "rr", "lf", "rf", "lr", "lb", "rb", "bl", "br", "hl", "hr", "vl", "vr"}
_SPEEDS = {"speed", "speeds", "spd", "vel", "velocity", "omega", "rpm", "rps", "wheel", "wheels", "encoder"}
NO_SPEEDS = {  # words of a wheel's name that say it is something else
  "angle", "steering", "steer", "torque", "current", "pressure", "brake", "temp", "temperature", "slip", "position",
  "pos", "ticks", "tick", "count", "counts", "pulses", *COMMANDED, "duty", "pwm", "throttle", "load", "force",
  "voltage",
}  # fmt: skip
_WHEELS, _MOTORS = {"wheel", "wheels", "axle", "rear", "front", *SIDES}, {"motor", "motors", "mot", "erpm"}
MEAN = "mean of "


def axle_means(table: Table) -> dict[str, np.ndarray]:
  """The mean of the speeds of a left and a right wheel, `mean of A and B`: the rear ones where four were logged."""
  for pair in (_pair(table.columns, *sides) for sides in _SIDES):
    if pair is None or any(name in table.ambiguous for name in pair):
      continue
    try:
      mean = 0.5 * (table.number(pair[0], pair[0]) + table.number(pair[1], pair[1]))
    except RecordingError:
      continue
    name = f"{MEAN}{pair[0]} and {pair[1]}"
    return {name: mean} if name not in table and np.isfinite(mean).any() else {}
  return {}


def of_wheels(name: str) -> bool:
  """Whether a speed is that of wheels or of an axle by its name, and not the motor's: `wheel_rl`, `rear_rpm`."""
  words = set(words_of(name))
  return bool(words & _WHEELS) and not words & _MOTORS


def pairs_of_wheels(names: Iterable[str]) -> list[tuple[str, str]]:
  """Every two columns of wheels' speeds whose names differ by the side alone, the left one first."""
  names = tuple(names)
  return list(dict.fromkeys(pair for sides in _SIDES for pair in _pairs(names, *sides)))


def _pair(names: Iterable[str], left: str, right: str) -> tuple[str, str] | None:
  """Two columns of wheels' speeds whose names differ by the side alone; None where there is not one pair."""
  pairs = _pairs(names, left, right)
  rear = [pair for pair in pairs if "rear" in words_of(pair[0])]
  pairs = rear or pairs
  return pairs[0] if len(pairs) == 1 else None


def _pairs(names: Iterable[str], left: str, right: str) -> list[tuple[str, str]]:
  words = {name: words_of(name) for name in names}
  named = _SPEEDS | ({"v"} if {left, right} <= SIDES else set())
  speeds = {name: w for name, w in words.items() if set(w) & named and not set(w) & NO_SPEEDS}
  swapped = lambda w: tuple(right if word == left else word for word in w)
  return [
    (a, b) for a, one in speeds.items() if one.count(left) == 1 for b, other in speeds.items() if swapped(one) == other
  ]
