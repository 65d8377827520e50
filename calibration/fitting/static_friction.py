"""Recordings in which the car stands although it is driven: static friction holds it.

They bound static friction and say nothing about the kinetic friction of a car that rolls; fitted with the
rest they would only bend it. The paper's identification leaves them out too.
"""

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.recording import Recording

STANDING = 0.02  # of the largest speed of all recordings: a slower car does not move
MOST = 0.8  # of the time with a drive command


def split_standing(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
  """Recordings to fit, and the names of those in which the car stands though driven for most of the time."""
  fastest = {name: max((_peak(r, name) for r in recordings), default=0.0) for name in ("motor_speed", "speed")}
  held = [r.name for r in recordings if _share(r, fastest) > MOST]
  return [r for r in recordings if r.name not in held], held


def _peak(recording: Recording, channel: str) -> float:
  return float(np.quantile(np.abs(recording[channel].value), 0.99)) if channel in recording else 0.0


def _share(recording: Recording, fastest: dict[str, float]) -> float:
  """Share of the time with a drive command in which the car does not move; 0 if there is no command at all."""
  channel = next((name for name in fastest if name in recording), None)
  if channel is None:
    return 0.0
  time, commands = recording.commands(0.02)
  driven = np.abs(commands[:, 0]) > 1e-6
  stream = recording[channel]
  slow = np.abs(np.interp(time, stream.time, stream.value)) < STANDING * fastest[channel]
  return float(np.mean(slow[driven])) if driven.any() else 0.0
