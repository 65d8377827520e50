"""Stretches in which the car answers the drive's command by less than half of what it does elsewhere.

A battery that dies or browns out, a drive that was cut off, a car that was held. How far each number below could be
moved is measured by `python -m tests.faults.thresholds`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.channels import SPEED_SETTING
from qcar_twin.recordings.checks.acted import WEAK, Stretch, idle_stretches
from qcar_twin.recordings.checks.driving import MOVING, PERIOD, RESTS, Drive, driven, runs
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


def weak_stretches(recordings: Sequence[Recording], channel: str) -> list[Stretch]:
  """Stretches in which the car neither moves as its command has asked for longer than any drive's lag, nor speeds up.

  The usual command for a motion is the lower quantile over all driving of

      command = a speed + b d(speed)/dt + friction sign(speed),

  since weak driving takes more. Where a battery's voltage was logged a duty is taken times it, so that only what the
  voltage doesn't explain is weak. A command that sets a force has none: in a slow turn the tyres take most of it.
  """
  if channel not in SPEED_SETTING:
    return []
  held = driven(recordings, channel)
  rows = [_rows(d) for d in held]
  top = max((float(np.percentile(np.abs(d.speed), 99.0)) for d in held), default=0.0)
  command, _, speed, change = np.concatenate([*rows, np.empty((4, 0))], axis=1)
  moving = (np.abs(speed) > MOVING * top) & (command * speed > 0.0)
  if moving.sum() < _LEAST_BINS:
    return []
  way = np.sign(speed[moving])
  line, spread = _usual(way * command[moving], way[:, None] * _design(speed[moving], change[moving]))
  least = float(np.percentile(np.abs(command[moving]), WEAK))
  holds = min(least, _STICKS * line[-1] + _SURE * spread) if line[-1] > 0.0 else least
  stretches = []
  for d, (_, asked, speed, change) in zip(held, rows, strict=True):
    way, friction = np.sign(asked), line[-1]
    missing = np.abs(asked) - friction - way * (_design(speed, change)[:, :-1] @ line[:-1])
    weak = (
      (np.abs(asked) >= np.where(np.abs(speed) > RESTS * top, least, holds))
      & (asked * speed >= 0.0)
      & (way * change < _SPEEDS_UP * top)
    )
    weak &= missing > np.maximum((1.0 - _ANSWERED) * (np.abs(asked) - friction), _SURE * spread)
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
  """Command, the least of it over a lag before, speed and its change per s, means of bins, (4, k)."""
  command, count = drive.command, round(_BIN / PERIOD)
  battery = drive.recording.battery
  if drive.recording.drive_channel == "motor_duty" and battery is not None:
    command = command * np.interp(drive.time, battery.time, battery.value) / float(np.median(battery.value))
  change = np.gradient(drive.speed, PERIOD) if drive.speed.size > 1 else 0.0 * drive.speed
  before = np.lib.stride_tricks.sliding_window_view(
    np.r_[np.zeros(lag := round(_LONGEST_LAG / PERIOD)), command], lag + 1
  )
  asked = np.maximum(before.min(axis=1), 0.0) + np.minimum(before.max(axis=1), 0.0)
  whole = drive.time.size // count * count
  return np.stack([v[:whole].reshape(-1, count).mean(axis=1) for v in (command, asked, drive.speed, change)])


def _design(speed: np.ndarray, change: np.ndarray) -> np.ndarray:
  return np.stack([speed, change, np.sign(speed)], axis=1)


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
