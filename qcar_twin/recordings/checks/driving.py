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
_HELD = 0.01  # s, of the grid on which held commands are looked at
_TURN, _TURNS = 0.1, 0.02  # s in which a servo is told a way, and rad from which on that is one
_EDGE = 1.0  # per cent of the driving that is left out at either end of its range
_WIDER = 0.1  # of the range, by which it is widened: so far a fit is trusted beyond what it saw
_DRIVEN = 0.1  # of the largest drive command, below which the car is taken to stand or to coast
OUTSIDE = 0.1  # share of the judging drives that may lie outside what is fitted


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


def least_driven(recordings: Sequence[Recording]) -> float:
  """Command of the drive, in its unit, either way, below which cars of these recordings stand or coast."""
  commands = [np.abs(recording.commands(_HELD)[1][:, 0]) for recording in recordings]
  return _DRIVEN * max(float(c.max(initial=0.0)) for c in commands)


@dataclass(frozen=True)
class Shown:
  """What a recording shows of a car.

  Attributes:
    driven: command of the drive in its unit, that of the steering, rad, and speed of motor or car times yaw rate, in
      the speed's unit times rad/s, (k, 3), while the car is driven; sign and all.
    told: how far the steering's command goes in 0.1 s where it goes anywhere, rad, (m,).
  """

  driven: np.ndarray
  told: np.ndarray

  @classmethod
  def of(cls, recording: Recording, least: float) -> Shown:
    """While the command of the drive exceeds `least`, in its unit, either way."""
    time, commands = recording.commands(_HELD)
    driven = np.column_stack([commands, _going_round(recording, time)])
    ahead = round(_TURN / _HELD)
    told = np.abs(commands[ahead:, 1] - commands[:-ahead, 1])
    return cls(driven[np.abs(commands[:, 0]) > least], told[told > _TURNS])

  def beyond(self, reach: Reach | None) -> np.ndarray:
    """Share of it that lies outside what others reach: of the three that are driven, and of the fourth, (4,)."""
    if reach is None:
      return np.zeros(4)
    return np.array([*map(_share, self._away(reach).T), _share(self.told > reach.told)])

  def outside(self, reach: Reach | None) -> float:
    """Share of the driving that lies outside in any of the three, or in the fourth where that is more."""
    if reach is None or not len(self.driven):
      return 0.0
    return max(_share(np.any(self._away(reach), axis=1)), _share(self.told > reach.told))

  def _away(self, reach: Reach) -> np.ndarray:
    return (self.driven < reach.low) | (self.driven > reach.high)


@dataclass(frozen=True)
class Reach:
  """Between what, (3,), and up to how fast a turn of the steering's command, rad in 0.1 s, recordings show a car."""

  low: np.ndarray
  high: np.ndarray
  told: float

  @classmethod
  def of(cls, shown: Sequence[Shown]) -> Reach | None:
    """Of several together, and a little more; None where nothing was driven."""
    driven = np.concatenate([np.zeros((0, 3)), *(s.driven for s in shown)])
    told = np.concatenate([np.zeros(0), *(s.told for s in shown)])
    if not len(driven):
      return None
    low, high = np.percentile(driven, [_EDGE, 100.0 - _EDGE], axis=0)
    room = _WIDER * (high - low)
    fastest = float(np.percentile(told, 100.0 - _EDGE)) if len(told) else _TURNS
    return cls(low - room, high + room, (1.0 + _WIDER) * fastest)


def _share(of: np.ndarray) -> float:
  return float(np.mean(of)) if len(of) else 0.0


def _going_round(recording: Recording, time: np.ndarray) -> np.ndarray:
  """Speed times yaw rate as both were measured, (T,); 0 where either was not."""
  speed = next((recording[name] for name in ("motor_speed", "speed") if name in recording), None)
  if speed is None or "yaw_rate" not in recording:
    return np.zeros(len(time))
  return np.nan_to_num(speed.interpolate(time) * recording["yaw_rate"].interpolate(time))
