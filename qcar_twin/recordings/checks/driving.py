"""Commands and speed of a set of recordings on one grid: where the car stands, where it is driven steadily."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.checks.faults import Runs
from qcar_twin.recordings.checks.time import MIN_SAMPLES, gap_limit
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
_COASTS = 0.3  # s, after which no drive pulls on any more that is told nothing
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
  recording's own is noise. One in which nothing was logged for long is several: what was between is not known."""
  rows = [row for r in recordings for part in _without_gaps(r) if (row := _row(part, channel)) is not None]
  top = float(np.percentile(np.abs(np.concatenate([speed for *_, speed in rows])), 99.0)) if rows else 0.0
  return [Drive(*row, stands := np.abs(row[-1]) <= RESTS * top, _answered(stands)) for row in rows]


def gaps(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
  """Times at which anything was logged, s, (k,), and the rows of those before which nothing was logged for long."""
  time = np.unique(np.concatenate([stream.time for stream in recording.streams.values()]))
  steps = [float(np.median(np.diff(stream.time))) for stream in recording.streams.values() if len(stream) > 1]
  return time, np.flatnonzero(np.diff(time) > gap_limit(min(steps, default=0.0))) + 1


def _without_gaps(recording: Recording) -> list[Recording]:
  """Its parts, each logged throughout."""
  time, after = gaps(recording)
  if not after.size:
    return [recording]
  return [recording.window(part[0], part[-1]) for part in np.split(time, after) if part.size >= MIN_SAMPLES]


def _row(recording: Recording, channel: str) -> tuple[Recording, np.ndarray, np.ndarray, np.ndarray] | None:
  name = "motor_speed" if "motor_speed" in recording else "speed"
  if channel not in recording or name not in recording or len(recording[name]) < 2 or channel in recording.derived:
    return None
  time, commands = recording.commands(PERIOD, (channel,))
  stream = recording[name]
  known = (time >= stream.time[0] - PERIOD) & (time <= stream.time[-1] + PERIOD)  # of the rest nothing was measured
  time, command = time[known], commands[known, 0]
  return recording, time, command, np.interp(time, stream.time, stream.value)


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


def least_driven(recordings: Sequence[Recording]) -> tuple[float, float]:
  """Command of the drive, in its unit, either way, below which cars of these recordings stand or coast, and speed, in
  that of the motor's or car's, below which they stand."""
  grids = [(recording, *recording.commands(_HELD)) for recording in recordings]
  command = max(float(np.abs(commands[:, 0]).max(initial=0.0)) for _, _, commands in grids)
  speeds = np.concatenate([np.abs(_speed(recording, time)) for recording, time, _ in grids])
  return _DRIVEN * command, RESTS * float(np.percentile(speeds, 100.0 - _EDGE))


@dataclass(frozen=True)
class Shown:
  """What a recording shows of a car.

  Attributes:
    driven: command of the drive in its unit, that of the steering, rad, and speed of motor or car times yaw rate, in
      the speed's unit times rad/s, (k, 3), while the car is driven; sign and all.
    coasted: how fast it goes, either way, in the speed's unit, while it moves and is not driven, (c,).
    told: how far the steering's command goes in 0.1 s where it goes anywhere, rad, (m,).
  """

  driven: np.ndarray
  coasted: np.ndarray
  told: np.ndarray

  @classmethod
  def of(cls, recording: Recording, least: tuple[float, float]) -> Shown:
    """It is driven while the command of the drive, either way, exceeds the first of `least`, and moves at more than the
    second, see `least_driven`."""
    time, commands = recording.commands(_HELD)
    is_driven, speed = np.abs(commands[:, 0]) > least[0], _speed(recording, time)
    driven = np.column_stack([commands, _going_round(recording, time, speed)])
    ahead = round(_TURN / _HELD)
    told = np.abs(commands[ahead:, 1] - commands[:-ahead, 1])
    return cls(driven[is_driven], _coasted(is_driven, np.abs(speed), least[1]), told[told > _TURNS])

  def __len__(self) -> int:
    """Of the samples that it is driven for or coasts for."""
    return len(self.driven) + len(self.coasted)

  def beyond(self, reach: Reach | None) -> np.ndarray:
    """Share of it that lies outside what others reach: of the three that are driven, of all that coasts faster, and of
    the turns of the steering, (5,)."""
    if reach is None:
      return np.zeros(5)
    coasts = np.sum(self.coasted > reach.coasted) / max(len(self), 1)
    return np.array([*map(_share, self._away(reach).T), coasts, _share(self.told > reach.told)])

  def outside(self, reach: Reach | None) -> float:
    """Share that lies outside in any of the three or coasts faster, or of the turns where that is more."""
    if reach is None or not len(self):
      return 0.0
    away = np.sum(np.any(self._away(reach), axis=1)) + np.sum(self.coasted > reach.coasted)
    return max(float(away) / len(self), _share(self.told > reach.told))

  def _away(self, reach: Reach) -> np.ndarray:
    return (self.driven < reach.low) | (self.driven > reach.high)


@dataclass(frozen=True)
class Reach:
  """Between what, (3,), from how fast it coasts, and up to how fast a turn of the steering's command, rad in 0.1 s,
  recordings show a car."""

  low: np.ndarray
  high: np.ndarray
  coasted: float
  told: float

  @classmethod
  def of(cls, shown: Sequence[Shown]) -> Reach | None:
    """Of several together, and a little more; None where nothing was driven."""
    driven = np.concatenate([np.zeros((0, 3)), *(s.driven for s in shown)])
    coasted = np.concatenate([np.zeros(0), *(s.coasted for s in shown)])
    told = np.concatenate([np.zeros(0), *(s.told for s in shown)])
    if not len(driven):
      return None
    low, high = np.percentile(driven, [_EDGE, 100.0 - _EDGE], axis=0)
    room = _WIDER * (high - low)
    most = lambda of, none: (1.0 + _WIDER) * (float(np.percentile(of, 100.0 - _EDGE)) if len(of) else none)
    return cls(low - room, high + room, most(coasted, 0.0), most(told, _TURNS))


def _share(of: np.ndarray) -> float:
  return float(np.mean(of)) if len(of) else 0.0


def _coasted(is_driven: np.ndarray, speed: np.ndarray, least: float) -> np.ndarray:
  """Of the speed, either way, (T,), what a car has that moves and has not been driven for a while, (c,)."""
  pulled = np.convolve(is_driven, np.ones(round(_COASTS / _HELD)))[: len(speed)] > 0.0
  return speed[~pulled & (speed > least)]


def _speed(recording: Recording, time: np.ndarray) -> np.ndarray:
  """Of the motor, or of the car, as it was measured, (T,); 0 where none was."""
  speed = next((recording[name] for name in ("motor_speed", "speed") if name in recording), None)
  return np.zeros(len(time)) if speed is None else np.nan_to_num(speed.interpolate(time))


def _going_round(recording: Recording, time: np.ndarray, speed: np.ndarray) -> np.ndarray:
  """Speed times yaw rate as both were measured, (T,); 0 where either was not."""
  if "yaw_rate" not in recording:
    return np.zeros(len(time))
  return np.nan_to_num(speed * recording["yaw_rate"].interpolate(time))
