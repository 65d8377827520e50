"""Commands and speed of a set of recordings on one grid: where the car stands, where it is driven steadily."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.checks.faults import Runs
from qcar_twin.recordings.recording import Recording

PERIOD = 0.05  # s, of the grid on which commands and motion are compared
MOVING, _SLOWS = 0.2, 0.1  # of the top speed: from which the car drives, and so much less in a second is slowing down
RESTS = 0.03  # of the usual top speed of the set, below which the car stands
_ANSWERS = 0.5  # s, within which a car that stands has answered a command; no drive's lag is longer
LEAST_REST = 2.0  # s at rest that tell a neutral; of driving: a sign


@dataclass(frozen=True)
class Drive:
  """A recording's command and speed on a grid, (k,), whether the car stands, and whether it has answered by then."""

  recording: Recording
  time: np.ndarray
  command: np.ndarray
  speed: np.ndarray
  stands: np.ndarray
  rest: np.ndarray


def driven(recordings: Sequence[Recording], channel: str) -> list[Drive]:
  """Those recordings that have the command and a measured speed. What standing is goes by the set's top speed: a parked
  recording's own is noise."""
  rows = [row for r in recordings if (row := _row(r, channel)) is not None]
  top = float(np.percentile(np.abs(np.concatenate([speed for *_, speed in rows])), 99.0)) if rows else 0.0
  return [Drive(*row, stands := np.abs(row[-1]) <= RESTS * top, _answered(stands)) for row in rows]


def _row(recording: Recording, channel: str) -> tuple[Recording, np.ndarray, np.ndarray, np.ndarray] | None:
  name = "motor_speed" if "motor_speed" in recording else "speed"
  if channel not in recording or name not in recording or len(recording[name]) < 2 or channel in recording.derived:
    return None
  time, commands = recording.commands(PERIOD, (channel,))
  stream = recording[name]
  return recording, time, commands[:, 0], np.interp(time, stream.time, stream.value)


def _answered(stands: np.ndarray) -> np.ndarray:
  """Where the car stands and has stood, and goes on standing, for as long as an answer to a command may take."""
  count, rest = round(_ANSWERS / PERIOD), np.zeros(stands.size, dtype=bool)
  for first, last, value in runs(stands):
    if value:
      rest[first + count : max(last + 1 - count, 0)] = True
  return rest


def steady(drive: Drive) -> np.ndarray:
  """Where the car moves and does not slow down, (k,)."""
  top = float(np.percentile(np.abs(drive.speed), 99.0))
  speed = smoothed(np.abs(drive.speed), 5)
  change = np.gradient(speed, PERIOD) if speed.size > 1 else 0.0 * speed
  return ~drive.stands & (speed > MOVING * top) & (change > -_SLOWS * top)


def smoothed(values: np.ndarray, count: int) -> np.ndarray:
  """Means over `count` samples about each, (k,), however few there are; beyond the ends are zeros."""
  first = (count - 1) // 2
  return np.convolve(values, np.full(count, 1.0 / count))[first : first + values.size]


def runs(mask: np.ndarray) -> list[tuple[int, int, bool]]:
  """First and last row of each run of equal values, and the value."""
  same = Runs.of(mask.astype(float))
  return [(int(a), int(b), bool(v)) for a, b, v in zip(same.first, same.last, same.value, strict=True)]
