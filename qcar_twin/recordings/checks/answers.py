"""Stretches in which the car answers the drive's command by less than half of what it does elsewhere.

A battery that dies or browns out, a drive that was cut off, a car that was held, a controller that brakes first. How
far each number below could be moved is measured by `python -m tests.faults.thresholds`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.channels import SPEED_SETTING
from qcar_twin.recordings.checks.acted import OFF, WEAK, Stretch, braked, idle_stretches
from qcar_twin.recordings.checks.driving import LEAST_REST, MOVING, PERIOD, RESTS, Drive, driven, runs, steady
from qcar_twin.recordings.recording import Recording

_BIN = 0.25  # s, over which command, speed and its change are averaged
_LEAST_BINS = 40  # 10 s of driving forwards or backwards, from which the usual answer is known
_ANSWERED = 0.5  # of what a command has beyond friction, by what the motion takes: halfway between all and nothing
_LONGEST_LAG = 0.5  # s, within which a drive has answered: only what was asked for so long before is asked of it
_LEAST = 2  # bins in a row: one may hold a bump
_SPEEDS_UP = 0.1  # of the top speed in a second, from which a car follows a command that a drive limits by a ramp
_SURE = 3.0  # deviations of the usual answer
_STICKS = 2.0  # times the friction of a car that moves: no more holds one that stands
_LOWER = 0.3  # quantile of commands for a motion: the median of the sound ones where two fifths of the driving is weak
_BLOCK = 3.0  # s of driving that are left out together: longer than any motion remembers
_OFTEN = 2  # presses that brake: once, the car may have been held
_STOPS = 0.5  # s at rest under such a press: no drive's lag is longer
_LATER = 0.8  # share of the driving backwards that is under later presses: an hour of a drive has odd seconds
_ROUNDS = 20  # of reweighting, after which the line moves no more
_APART = 0.5  # s, between two stretches that are one


def unanswered_stretches(recordings: Sequence[Recording], channel: str) -> list[Stretch]:
  """Where the car stands under a command that drives it elsewhere, or answers it by less than half; in order."""
  each = [*idle_stretches(recordings, channel), *weak_stretches(recordings, channel)]
  whole: list[Stretch] = []
  for recording in recordings:
    for one in sorted((s for s in each if s.recording is recording), key=lambda s: s.start):
      if whole and whole[-1].recording is recording and one.start - whole[-1].end < _APART:
        whole[-1] = Stretch(recording, channel, whole[-1].start, max(whole[-1].end, one.end))
      else:
        whole.append(one)
  return whole


def braked_stretches(recordings: Sequence[Recording], channel: str) -> list[Stretch]:
  """Where the car stands under the first press of a negative command after one forwards, while later presses drive it
  backwards: a usual speed controller (ESC) of a model car brakes first. Nothing where that was seen once only."""
  held = driven(recordings, channel)
  reverse = [steady(d) & (d.command < 0.0) & (d.speed < 0.0) for d in held]
  commands = np.concatenate([np.abs(d.command[r]) for d, r in zip(held, reverse, strict=True)] or [np.empty(0)])
  if commands.size * PERIOD < LEAST_REST:
    return []
  least, braking, stretches = float(np.percentile(commands, WEAK)), 0, []
  for d, back in zip(held, reverse, strict=True):
    first = _first_press(d.command, OFF * least)
    braking += int(np.sum(back & first))
    stretches += [
      Stretch(d.recording, channel, float(d.time[a]), float(d.time[b]))
      for a, b, idle in runs(d.stands & first & (d.command <= -least))
      if idle and (b + 1 - a) * PERIOD >= _STOPS
    ]
  return stretches if len(stretches) >= _OFTEN and braking < (1.0 - _LATER) * commands.size else []


def _first_press(command: np.ndarray, off: float) -> np.ndarray:
  """Where a command backwards is the first after one forwards, (k,)."""
  first, forwards = np.zeros(command.size, dtype=bool), False
  for a, b, back in runs(command < -off):
    if back:
      first[a : b + 1], forwards = forwards, False
    else:
      forwards = forwards or bool((command[a : b + 1] > off).any())
  return first


def command_per_speed(recordings: Sequence[Recording], channel: str) -> tuple[float, float] | None:
  """How much more of a command a car takes to go faster, in the channel's unit per unit of the measured speed, and its
  standard deviation, by leaving out 3 s in turn; None where this driving hardly tells it."""
  held = driven(recordings, channel)
  command, _, speed, change, across = np.concatenate([*(_rows(d) for d in held), np.empty((5, 0))], axis=1)
  top = max((float(np.percentile(np.abs(d.speed), 99.0)) for d in held), default=0.0)
  moving = (np.abs(speed) > MOVING * top) & (command * speed > 0.0)
  if moving.sum() < _LEAST_BINS:
    return None
  way = np.sign(speed[moving])
  design, given = way[:, None] * _design(speed[moving], change[moving], across[moving]), way * command[moving]
  low, high = np.percentile(given, [5.0, 95.0])
  if high - low < MOVING * high:  # about one level, which friction explains as well
    return None
  line = lambda rows: float(np.linalg.lstsq(design[rows], given[rows], rcond=None)[0][0])
  block = np.arange(given.size) // round(_BLOCK / _BIN)
  without = np.array([line(block != b) for b in range(block[-1] + 1)])
  spread = np.sqrt((without.size - 1) / without.size * np.sum((without - without.mean()) ** 2))
  return line(block >= 0), float(spread)


def weak_stretches(recordings: Sequence[Recording], channel: str) -> list[Stretch]:
  """Stretches in which the car neither moves as its command has asked for longer than any drive's lag, nor speeds up.

  The usual command for a motion is

      command = a speed + b d(speed)/dt + c (speed * yaw rate)^2 sign(speed) + friction sign(speed),

  the third what tyres take that push a car round, where a yaw rate was logged: else a car that is mostly driven in
  circles, slower under more of a command, would seem to be all friction. Over all driving it is the lower quantile,
  since weak driving takes more. Where a battery's voltage was logged a duty is taken times it, so that only what the
  voltage doesn't explain is weak. A command that sets a force has none: in a slow turn the tyres take most of it.
  """
  if channel not in SPEED_SETTING:
    return []
  held = driven(recordings, channel)
  rows = [_rows(d) for d in held]
  top = max((float(np.percentile(np.abs(d.speed), 99.0)) for d in held), default=0.0)
  command, _, speed, change, across = np.concatenate([*rows, np.empty((5, 0))], axis=1)
  moving = (np.abs(speed) > MOVING * top) & (command * speed > 0.0)
  if moving.sum() < _LEAST_BINS:
    return []
  way = np.sign(speed[moving])
  line, spread = _usual(way * command[moving], way[:, None] * _design(speed[moving], change[moving], across[moving]))
  least = float(np.percentile(np.abs(command[moving]), WEAK))
  holds = min(least, _STICKS * line[-1] + _SURE * spread) if line[-1] > 0.0 else least
  stretches = []
  for d, brakes, (_, asked, speed, change, across) in zip(held, braked(held, channel), rows, strict=True):
    way, friction = np.sign(asked), line[-1]
    missing = np.abs(asked) - friction - way * (_design(speed, change, across)[:, :-1] @ line[:-1])
    weak = (
      (np.abs(asked) >= np.where(np.abs(speed) > RESTS * top, least, holds))
      & ((asked * speed >= 0.0) | (np.abs(speed) <= RESTS * top))  # of a car that stands the sign is noise
      & (np.abs(asked) - friction > way * line[0] * speed)  # a faster one slows down to where its command keeps it
      & (way * change < _SPEEDS_UP * top)
    )
    weak &= missing > np.maximum((1.0 - _ANSWERED) * (np.abs(asked) - friction), _SURE * spread)
    weak &= ~_any(brakes)
    begin = float(d.time[0]) if d.time.size else 0.0
    for first, last in _parts(weak, answers=~weak & (np.abs(speed) > RESTS * top)):
      stretches.append(Stretch(d.recording, channel, begin + first * _BIN, begin + (last + 1) * _BIN))
  return stretches


def _parts(weak: np.ndarray, answers: np.ndarray) -> list[tuple[int, int]]:
  """First and last bin of runs that are weak; one from two between which the car never answers, and to the end where it
  never does again."""
  parts: list[tuple[int, int]] = []
  for first, last, lacks in runs(weak):
    if not lacks or last + 1 - first < _LEAST:
      continue
    if parts and not answers[parts[-1][1] : first].any():
      parts[-1] = (parts[-1][0], last)
    else:
      parts.append((first, last))
  if parts and not answers[parts[-1][1] :].any():
    parts[-1] = (parts[-1][0], len(answers) - 1)
  return parts


def _rows(drive: Drive) -> np.ndarray:
  """Command, the least of it over a lag before, speed, its change per s, (speed * yaw rate)^2: means of bins (5, k)."""
  command, count = drive.command, round(_BIN / PERIOD)
  battery = drive.recording.battery
  if drive.recording.drive_channel == "motor_duty" and battery is not None:
    command = command * np.interp(drive.time, battery.time, battery.value) / float(np.median(battery.value))
  change = np.gradient(drive.speed, PERIOD) if drive.speed.size > 1 else 0.0 * drive.speed
  before = np.lib.stride_tricks.sliding_window_view(
    np.r_[np.zeros(lag := round(_LONGEST_LAG / PERIOD)), command], lag + 1
  )
  asked = np.maximum(before.min(axis=1), 0.0) + np.minimum(before.max(axis=1), 0.0)
  gyro = drive.recording.streams.get("yaw_rate")
  turning = np.interp(drive.time, gyro.time, gyro.value) if gyro is not None and len(gyro) else 0.0 * drive.speed
  whole = drive.time.size // count * count
  means = [command, asked, drive.speed, change, (drive.speed * turning) ** 2]
  return np.stack([v[:whole].reshape(-1, count).mean(axis=1) for v in means])


def _any(mask: np.ndarray) -> np.ndarray:
  """Bins in which a mask of the grid holds anywhere."""
  count = round(_BIN / PERIOD)
  return np.asarray(np.any(mask[: mask.size // count * count].reshape(-1, count), axis=1))


def _design(speed: np.ndarray, change: np.ndarray, across: np.ndarray) -> np.ndarray:
  return np.stack([speed, change, across * np.sign(speed), np.sign(speed)], axis=1)


def _usual(command: np.ndarray, design: np.ndarray) -> tuple[np.ndarray, float]:
  """The line below which a lower quantile of the commands lies, and the deviation of those around it."""
  line = np.linalg.lstsq(design, command, rcond=None)[0]
  for _ in range(_ROUNDS):
    left = command - design @ line
    side = np.where(left > 0.0, _LOWER, 1.0 - _LOWER)
    root = np.sqrt(side / np.maximum(np.abs(left), 1e-6 * float(np.abs(command).max())))
    line = np.linalg.lstsq(design * root[:, None], command * root, rcond=None)[0]
  left = command - design @ line
  return line, 1.4826 * float(np.median(-left[left <= 0.0]))
