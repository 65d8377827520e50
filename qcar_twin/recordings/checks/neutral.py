"""The value of a command with which the car stands, or goes straight on.

How far each number below could be moved is measured by `python -m tests.faults.thresholds`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.checks.driving import LEAST_REST, MOVING, PERIOD, Drive, driven, runs, steady
from qcar_twin.recordings.completed import heading_or_course
from qcar_twin.recordings.recording import Recording

_NEAR = 0.02  # of the command's range: one level
_MOST = 0.25  # share of the rest that a neutral has; commands too small to break the car away take the others
_NEVER = 0.5  # of the largest command: what stays beyond it never comes near 0
_OFF = 0.1  # of the command's range, beyond which a neutral is not 0
_RARE = 0.05  # share of the driving that a level may take part in and still not drive the car
_BIN = 0.25  # s, over which turning is compared with steering, and speed with the command
_GENTLE = 4.0  # m/s^2 across, below which the turning is proportional to the angle
_CENTRED = 0.35  # of the largest steering command, within which a straight-ahead is a trim; usual ones are up to 0.25
_SURE = 0.05  # of the largest steering command: standard deviation of a straight-ahead that says anything


@dataclass(frozen=True)
class Neutral:
  """The value of a command with which the car stands or goes straight on, in the channel's unit, and why; not `sure`
  where friction may have held the car."""

  channel: str
  value: float
  why: str
  sure: bool = True


def drive_neutral(recordings: Sequence[Recording], channel: str) -> Neutral | None:
  """The level that the drive's command has while the car stands, where it is not 0 and how the car drives confirms it.

  Four things are asked of it. It is the commonest level at rest, and 0 is none. It never keeps the car going. It lies
  nearer than 0 to where the driving says that the speed is nothing. Forward driving alone gives that point with
  friction's share, and friction holds a car under small commands: the level is sure if it stopped the car, too, or if
  friction would have to take half of the largest command.
  """
  held = driven(recordings, channel)
  if not held:
    return None
  rest, span = np.concatenate([d.command[d.rest] for d in held]), _span(held)
  if rest.size * PERIOD < LEAST_REST or span == 0.0:
    return None
  level = _commonest(rest, _NEAR * span)
  near = lambda command: np.abs(command - level) < _NEAR * span
  zero = np.mean(np.abs(rest) < _NEAR * span)
  if np.mean(near(rest)) < _MOST or zero > _RARE or abs(level) < _OFF * span or _keeps_going(held, near) > _RARE:
    return None
  standstill = _standstill(held)
  if standstill is None or abs(level - standstill.command) > abs(standstill.command):
    return None
  top = max(float(np.percentile(np.abs(d.command), 99.0)) for d in held)
  sure = standstill.both_ways or abs(standstill.command) > _NEVER * top or _stopped(held, near)
  said = f"the car stands under {level:.4g}, for {rest.size * PERIOD:.0f} s, and never drives on under it"
  return Neutral(channel, level, said, sure)


@dataclass(frozen=True)
class _Standstill:
  """The command under which driving says that a speed of 0 is kept; with `both_ways` without friction's share."""

  command: float
  both_ways: bool


def _standstill(held: Sequence[Drive]) -> _Standstill | None:
  """Where the steady speed's line over the command crosses 0, by least squares over bins in which the car moves on:

      command = standstill + a speed + b d(speed)/dt + friction sign(speed)

  The last term is told apart where the car was driven both ways; else it is in the first. None without enough driving.
  """
  count = round(_BIN / PERIOD)
  rows = [np.stack([_bins(d.command, count), _bins(d.speed, count), _change(d.speed, count)]) for d in held]
  tops = [float(np.percentile(np.abs(d.speed), 99.0)) for d in held]
  moving = [
    r[:, (_bins(~d.stands, count) == 1.0) & (np.abs(r[1]) > MOVING * top)]
    for d, r, top in zip(held, rows, tops, strict=True)
  ]
  command, speed, change = np.concatenate(moving, axis=1)
  least = LEAST_REST / _BIN
  both_ways = min(np.sum(speed > 0.0), np.sum(speed < 0.0)) >= least
  columns = [np.ones(speed.size), speed, change, *([np.sign(speed)] if both_ways else [])]
  if speed.size < least:
    return None
  (standstill, *_), _, rank, _ = np.linalg.lstsq(np.stack(columns, axis=1), command, rcond=None)
  return _Standstill(float(standstill), bool(both_ways)) if rank == len(columns) else None


def _bins(values: np.ndarray, count: int) -> np.ndarray:
  """Means of `count` values each; what is left at the end is left out."""
  return values[: values.size // count * count].reshape(-1, count).mean(axis=1)


def _change(values: np.ndarray, count: int) -> np.ndarray:
  """Mean slope in each bin, per s."""
  return _bins(np.gradient(values, PERIOD) if values.size > 1 else values, count)


def _stopped(held: Sequence[Drive], near: Callable[[np.ndarray], np.ndarray]) -> bool:
  """Whether a moving car ever came to rest under commands that are `near`."""
  return any(
    rests and near(d.command)[first] and not d.stands[:first].all() for d in held for first, _, rests in runs(d.rest)
  )


def _commonest(values: np.ndarray, width: float) -> float:
  """Median of the values that lie within `width` of most others."""
  ordered = np.sort(values)
  last = np.searchsorted(ordered, ordered + 2.0 * width, side="right")
  first = int(np.argmax(last - np.arange(ordered.size)))
  return float(np.median(ordered[first : last[first]]))


def least_command(recordings: Sequence[Recording], channel: str) -> float | None:
  """The command nearest to 0, where the car stood for a while and nothing near 0 was ever commanded, else None.

  Whether that is a neutral or commands too small to move the car, only a person knows.
  """
  held = driven(recordings, channel)
  command = np.concatenate([d.command for d in held]) if held else np.empty(0)
  if sum(int(d.stands.sum()) for d in held) * PERIOD < LEAST_REST or not command.size:
    return None
  least = float(command[np.argmin(np.abs(command))])
  return least if abs(least) > _NEVER * float(np.abs(command).max()) else None


def switched_command(recordings: Sequence[Recording], channel: str) -> float | None:
  """The command nearest to 0 but 0 itself, where the car stood for a while under others than 0, and the way from 0 to
  it is longer than any other between two commands: a neutral, under a switch that makes a 0 of it."""
  held = driven(recordings, channel)
  command = np.concatenate([d.command for d in held]) if held else np.empty(0)
  resting = sum(int(np.sum(d.rest & (d.command != 0.0))) for d in held) * PERIOD
  if resting < LEAST_REST:
    return None
  given = np.unique(command[command != 0.0])
  least = float(given[np.argmin(np.abs(given))])
  one_sided = given[0] > 0.0 or given[-1] < 0.0
  return least if one_sided and abs(least) > float(np.max(np.diff(given), initial=0.0)) else None


def _span(held: Sequence[Drive]) -> float:
  low, high = np.percentile(np.concatenate([d.command for d in held]), [1, 99])
  return float(high - low)


def _keeps_going(held: Sequence[Drive], near: Callable[[np.ndarray], np.ndarray]) -> float:
  """Share of the steady driving that happens under commands that are `near`."""
  on = [steady(d) for d in held]
  every = sum(int(s.sum()) for s in on)
  under = sum(int(np.sum(s & near(d.command))) for d, s in zip(held, on, strict=True))
  return under / every if every else 1.0


def steering_neutral(recordings: Sequence[Recording]) -> Neutral | None:
  """The steering command with which the car goes straight on, where it is so far from 0 that it is no trim.

  Least squares of yaw rate = a v command + b v in bins, gentle driving only: straight ahead at -b / a.
  """
  rows = [part for r in recordings if (part := _turning(r)) is not None]
  if not rows:
    return None
  speed, command, turning = np.concatenate(rows, axis=1)
  top = float(np.percentile(np.abs(command), 99.0)) if command.size else 0.0
  if command.size < 20 or top == 0.0:
    return None
  design = np.stack([speed * command, speed], axis=1)
  (slope, offset), squares, rank, _ = np.linalg.lstsq(design, turning, rcond=None)
  if rank < 2 or slope == 0.0 or not squares.size:
    return None
  straight = -offset / slope
  covariance = np.linalg.inv(design.T @ design) * float(squares[0]) / (command.size - 2)
  gradient = np.array([offset / slope**2, -1.0 / slope])
  spread = float(np.sqrt(gradient @ covariance @ gradient))
  low, high = np.percentile(command, [1, 99])
  if not (abs(straight) > _CENTRED * top and low < straight < high and spread < _SURE * top):
    return None
  return Neutral("steering_command", float(straight), f"the car goes straight on under {straight:.4g}")


def _turning(recording: Recording) -> np.ndarray | None:
  """Speed, steering command and yaw rate in bins where the car turns gently, (3, k)."""
  name = "motor_speed" if "motor_speed" in recording else "speed"
  if "steering_command" not in recording or name not in recording:
    return None
  edges = recording.start + _BIN * np.arange(int(recording.duration / _BIN) + 1)
  middle = 0.5 * (edges[1:] + edges[:-1])
  if middle.size == 0:
    return None
  if "yaw_rate" in recording:
    turning = recording["yaw_rate"].interpolate(middle)
  elif (heading := heading_or_course(recording)) is not None:
    turning = np.diff(heading.interpolate(edges)) / _BIN
  else:
    return None
  speed, command = recording[name].interpolate(middle), recording["steering_command"].at(middle)
  there = np.isfinite(turning) & np.isfinite(speed) & (np.abs(speed) > 0.0)
  if name == "speed":
    there &= np.abs(speed * turning) < _GENTLE
  return np.stack([speed, command, turning])[:, there]
