"""Commands in counts of full travel: a receiver's pulses, a radio's sticks, a game's bytes. Their names tell, and what
lies beside them; no sensor does.

A receiver's pulses go by 500 us to either side of 1500. Betaflight's blackbox has sticks of +-500 and a throttle of
pulses, `rcCommand[0]` to `[3]`, and the motor's electrical rpm over 100, `eRPM[0]` (its documentation, "Blackbox" and
"DSHOT RPM filtering"). EdgeTX logs all four sticks, +-1024 (its user manual, "SD logs"). Games send a byte a pedal, 0
to 255, and a signed one of steering (Forza's "data out").
"""

import re
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.unit_names import unit_of, words_of

Array = NDArray[np.float64]
Values = Callable[[str], Array]  # all values of a column that are there
BRAKES = {"brake", "brakes", "braking", "brk"}
_PULSE = (900.0, 2100.0)  # us, of a radio-control servo or speed controller; 1500 is neutral, 500 the full travel
_STICKS = {"rud", "ele", "thr", "ail"}  # of a radio
_RADIO, _BLACKBOX, _BYTE, _SIGNED_BYTE = 1024.0, 500.0, 255.0, 127.0
_OF_BLACKBOX = re.compile(r"^\s*rcCommand\[[0-2]\]$")
_HUNDREDS = 100.0  # electrical rpm to a count of a blackbox
_PEDALS = {"accel", "accelerator", "acceleration", "throttle", "gas"}
LOCK = 0.7  # rad, 40 deg: beyond the road-wheel angle of any 1:10 car
LEAST_LOCK = 0.15  # rad, of a driven car's largest steering: full lock is 0.35 to 0.7, and gentle curves take a third
_NORMALISED = 1.05  # a command that stays within it, but beyond any 1:10 car's lock, is a share of full lock


def is_pulse(values: Array) -> bool:
  """Whether values are pulses of a radio control's servo or speed controller, us."""
  low, high = np.percentile(values, [1, 99])
  return bool(_PULSE[0] < low and high < _PULSE[1])


def stick_of(names: Sequence[str], values: Values, name: str) -> float | None:
  """The counts of a stick at full travel, by its name and those of the other columns, which do not say what it
  commands; None where a column is none."""
  most = float(np.abs(values(name)).max())
  if _OF_BLACKBOX.match(name) and most <= _BLACKBOX:
    return _BLACKBOX
  named = name.lower() in _STICKS and {other.lower() for other in names} >= _STICKS
  return _RADIO if named and _whole(values(name)) and most <= _RADIO else None


def pedals(names: Sequence[str], values: Values) -> list[str]:
  """Accelerators of whole numbers up to 255 beside a brake of such: `Accel` is no acceleration there."""
  of_bytes = [name for name in names if _is_byte(values(name))]
  if not any(set(words_of(name)) & BRAKES for name in of_bytes):
    return []
  full = lambda name: values(name).max() > 100.0  # else both may be in per cent
  return [name for name in of_bytes if set(words_of(name)) <= _PEDALS and full(name)]


def travel_of(names: Sequence[str], values: Values, channel: str, name: str) -> tuple[float, str] | None:
  """The factor from a command's counts to a share of full travel, and how that is said; None where it has no such."""
  if channel not in ("motor_duty", "steering_command") or unit_of(name) is not None:
    return None
  if (stick := stick_of(names, values, name)) is not None:
    return 1.0 / stick, f"a stick, {stick:g} to full travel"
  if channel != "steering_command" or not LOCK < np.abs(values(name)).max() <= _SIGNED_BYTE + 1.0:
    return None
  if not _whole(values(name)) or not pedals(names, values):
    return None
  return 1.0 / _SIGNED_BYTE, f"whole numbers beside a pedal of 0 to 255: a signed byte, {_SIGNED_BYTE:g} to full lock"


def hundreds(names: Sequence[str], name: str) -> float:
  """Electrical revolutions per minute to a count: 100 in Betaflight's blackbox, else 1."""
  own = "loopIteration" in names or any(map(_OF_BLACKBOX.match, names))
  return _HUNDREDS if own and name.strip().startswith("eRPM[") else 1.0


def is_share_of_lock(names: Sequence[str], values: Values, name: str, offset: float) -> bool:
  """Whether a steering command is a share of full lock rather than an angle: pulses and counts of full travel are, and
  small numbers without a unit."""
  unit, own = unit_of(name), values(name)
  if is_pulse(own) or (unit is not None and unit[1] == "-") or travel_of(names, values, "steering_command", name):
    return True
  return unit is None and (offset != 0.0 or LOCK < float(np.percentile(np.abs(own), 99.9)) <= _NORMALISED)


def _is_byte(values: Array) -> bool:
  return bool(_whole(values) and values.min() == 0.0 and 1.0 < values.max() <= _BYTE)


def _whole(values: Array) -> bool:
  return bool((values == np.round(values)).all())
