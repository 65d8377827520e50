"""Counts of an IMU whose unit nothing in the log tells: neither gravity, nor a heading, nor a speed."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.recordings.channels import CHANNELS, GRAVITY
from qcar_twin.recordings.first_dataset.columns import Columns, Guess
from qcar_twin.recordings.first_dataset.scales.sensor import axes_of_one
from qcar_twin.recordings.unit_names import unit_of

_SENSORS = (("accel_x", "accel_y"), ("yaw_rate",))
_MG = GRAVITY / 1000.0
_ASKED = {
  "m/s^2": "how many are 1 g by its data sheet? set scale = 9.80665 over that",
  "rad/s": "how many are 1 deg/s by its data sheet? set scale = 0.0174533 over that",
}


def asked_of_raw(columns: Columns, guesses: Mapping[str, Guess]) -> list[str]:
  """A question for each sensor whose whole numbers are beyond what any car does in SI units, and have no scale yet."""
  questions = []
  for names in _SENSORS:
    raw = [guesses[name] for name in names if name in guesses and _is_raw(columns, guesses[name])]
    if not raw:
      continue
    raw += [other for name in names if name in guesses and _beside(other := guesses[name], raw[0])]
    raw.sort(key=lambda guess: names.index(guess.channel))
    called = " and ".join(f"'{guess.column}'" for guess in raw) + (" hold" if len(raw) > 1 else " holds")
    most, channel = max(columns.top(guess.column) for guess in raw), CHANNELS[raw[0].channel]
    on = " and on ".join(guess.channel for guess in raw)
    said = f"counts of a sensor up to {most:.4g}, and nothing in the log tells their unit"
    questions.append(f"{called} {said}: {_ASKED[channel.unit]} on {on}, with the sign that it has")
  return questions


def _beside(guess: Guess, raw: Guess) -> bool:
  """Whether a guess is another axis of a sensor that counts, which its smaller values put into mg; it is unscaled."""
  if abs(guess.scale) != _MG or guess.named or not axes_of_one(guess.column, raw.column):
    return False
  guess.scale, guess.offset = float(np.sign(guess.scale)), 0.0
  guess.why = [*(why for why in guess.why if "too much for" not in why), f"counts, as '{raw.column}' beside it"]
  return True


def _is_raw(columns: Columns, guess: Guess) -> bool:
  values = columns.values(guess.column)
  whole = bool((values == np.round(values)).all())
  unscaled = abs(guess.scale) == 1.0 and unit_of(guess.column) is None
  return whole and unscaled and columns.top(guess.column) > CHANNELS[guess.channel].limit
