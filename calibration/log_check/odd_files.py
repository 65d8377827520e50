"""A file that was logged in another way than the others: another unit, sign or age of a channel, or another car.

`[channels]` holds for all files of a data set, so what differs between them no line there can mend.
"""

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from typing import TypeVar

import numpy as np

from calibration.fitting.noise import ChannelNoise
from calibration.log_check.causes import ALIKE, KNOTS, LATE, scaled, steered, tolerance
from calibration.log_check.disagreements import Finding, Severity
from calibration.log_check.motions import Wheels, motions
from calibration.log_check.pairs import LAGS, Comparison, Estimate, compare
from qcar_twin.recordings.channels import SPEED_SETTING
from qcar_twin.recordings.checks.answers import command_per_speed
from qcar_twin.recordings.checks.driving import driven, steady
from qcar_twin.recordings.checks.faults import at_range
from qcar_twin.recordings.recording import Recording

_T = TypeVar("_T")
_FILES = 2  # that can differ; of three and more one is odd
_UNIT = 10.0  # halfway, as factors go, between one unit and per cent of it
_LATE = 0.1  # s; an age that differs by less between drives is said of none
_OTHERWISE = 0.1  # share by which two sensors of a motion differ between drives of one car, by slip at most
_SURE = 5.0  # deviations: of dozens of files one lies beyond three by chance
# factor, of one car: a battery from full to empty changes a duty's speed by 4.2/3.3, dart's floor its turning so
_CHANGED = 1.3
_GRIP, _OFTEN = 4.0, 0.05  # m/s^2 across, half of what tyres of friction 0.8 hold, and in which part of a drive
_STEADY = 20  # bins of steady driving that give a file's speed per command


class TwoGroups(Finding):
  """That files are of two cars, or of one that was changed: what one answers is no measure of the other."""


def odd_file_findings(
  wheels: Wheels, recordings: Sequence[Recording], noise: Mapping[str, ChannelNoise]
) -> list[Finding]:
  """The files in which a drive's command, or one of two sensors of a motion, is not what it is in most others; of two
  files the second, as the one that differs from the first. Also files in two groups, as of two cars, without a most."""
  files: dict[str, list[Recording]] = {}
  for recording in recordings:
    files.setdefault(recording.file or recording.name, []).append(recording)
  if len(files) < _FILES:
    return []
  odd = [f for channel in SPEED_SETTING for f in _odd_commands(files, channel)]
  parts = [p for channel in SPEED_SETTING if (p := _parted(_drives(files, channel), (channel,), "drive"))]
  for motion in motions(wheels, recordings):
    if motion.kinematic or "steering_command" in motion.reference:
      sensors = (*motion.compared, *motion.reference)  # one at the end of its range has another scale in every drive
      whole = {n: held for n, held in files.items() if not any(at_range(r, s) for r in held for s in sensors)}
      each = {name: compare(motion, wheels, held, noise) for name, held in whole.items()}
      told = {name: c for name, c in each.items() if not c.why_not and abs(c.correlation) > ALIKE}
      odd += _odd_sensors(told, {name for name in told if steered(motion) and _slides(wheels, whole[name])})
      if steered(motion):
        scales = {name: c.scale for name, c in told.items() if scaled(c)}
        parts += [p] if (p := _parted(scales, (*motion.compared, *motion.reference), "turn")) else []
  return odd if any(f.severity == "spoils" for f in odd) else [*odd, *_groups(parts)]


@dataclasses.dataclass(frozen=True)
class _Parts:
  """Files in two groups, each in order; the numbers of the second are `factor` times those of the first, and the
  nearest two `gap` apart. `channels` tell it, of `what`: "turn" or "drive"."""

  first: tuple[str, ...]
  second: tuple[str, ...]
  factor: float
  gap: float
  channels: tuple[str, ...]
  what: str


def _drives(files: Mapping[str, Sequence[Recording]], channel: str) -> dict[str, Estimate]:
  """Command per speed of the files that tell it."""
  told = {n: command_per_speed([r for r in held if r.drive_channel == channel], channel) for n, held in files.items()}
  return {name: Estimate(*one) for name, one in told.items() if one and one[0] > _SURE * one[1]}


def _parted(each: Mapping[str, Estimate], channels: tuple[str, ...], what: str) -> _Parts | None:
  """Two groups of two files and more, further apart than _CHANGED, than noise, and than twice what either differs."""
  order = sorted(each, key=lambda name: each[name].value)
  span = lambda a, b: math.log(each[b].value / each[a].value)
  for k in range(_FILES, len(order) - _FILES + 1):
    gap = span(order[k - 1], order[k])
    noise = math.hypot(*(each[n].std / each[n].value for n in order[k - 1 : k + 1]))
    within = max(span(order[0], order[k - 1]), span(order[k], order[-1]))
    if gap > max(math.log(_CHANGED), _SURE * noise, 2.0 * within):
      middle = lambda names: float(np.median([each[n].value for n in names]))
      low, high = sorted((order[:k], order[k:]), key=lambda names: list(each).index(names[0]))
      factor = middle(high) / middle(low)
      return _Parts(tuple(sorted(low)), tuple(sorted(high)), factor, math.exp(gap), channels, what)
  return None


def _groups(parts: Sequence[_Parts]) -> list[Finding]:
  """Two groups of files: of two cars where turning and drive part them alike, else of two cars or a changed one."""
  by = {p.what: p for p in parts}
  both = [by["turn"], by["drive"]] if len(by) == 2 and {*by["turn"].first} == {*by["drive"].first} else []
  findings = []
  for group in [both] if both else [[p] for p in parts if p.gap > KNOTS]:
    named = [f"{', '.join(names[:-1])} and {names[-1]}" for names in (group[0].first, group[0].second)]
    ways = {
      "turn": "turns {:.3g} times as much for the same speed and steering_command",
      "drive": "takes {:.3g} times as much {} for the same speed",
    }
    said = " and ".join(ways[p.what].format(p.factor, p.channels[0]) for p in group)
    why = "two cars, or one that was changed (wheels, servo, gear, battery)"
    cure = "make a data set of each, since a fit is of one car"
    channels = tuple(dict.fromkeys(name for p in group for name in p.channels))
    text = f"the files fall into two groups, {named[0]} against {named[1]}: the car of the latter {said}: {why}; {cure}"
    findings.append(TwoGroups("spoils" if both else "beware", channels, text))
  return findings


def _odd_commands(files: Mapping[str, Sequence[Recording]], channel: str) -> list[Finding]:
  """Files in which the car drives as fast under a command many times as large, or as small, as in any other."""
  speeds = {}
  for name, recordings in files.items():
    held = driven([r for r in recordings if r.drive_channel == channel], channel)
    there = [steady(d) & (d.command != 0.0) for d in held]
    ratio = np.concatenate(
      [np.abs(d.speed[s] / d.command[s]) for d, s in zip(held, there, strict=True)] or [np.empty(0)]
    )
    if ratio.size >= _STEADY:
      speeds[name] = float(np.median(ratio))
  findings = []
  for name, speed in _compared(speeds):
    factors = np.array([v for other, v in speeds.items() if other != name]) / speed
    factor = float(np.median(factors))
    if factors.min() > _UNIT or factors.max() < 1.0 / _UNIT:
      said = f"{channel} is {factor:.3g} times as large in {name} as in {_others(name, speeds)} for the same speed"
      cure = f"it has another unit there: divide its column by that in {name}, and give [channels] the others' scale"
      findings.append(Finding("spoils", (channel,), f"{said}; {cure}"))
  return findings


def _odd_sensors(each: Mapping[str, Comparison], sliding: Collection[str]) -> list[Finding]:
  """Files in which two sensors of a motion differ by another sign, factor, share or lag than in the others; in those
  that are `sliding` a car may turn otherwise than it steers."""
  beside = lambda name: [o for other, o in each.items() if other != name]
  return [f for name, c in _compared(each) for f in _odd(name, c, beside(name), _others(name, each), name in sliding)]


def _slides(wheels: Wheels, recordings: Sequence[Recording]) -> bool:
  """Whether the car goes round so hard, for a part of the drive, that its tyres decide how much it turns.

  By an accelerometer, which no unit of a speed or a gyro touches; else by speed and gyro.
  """
  across = []
  for r in recordings:
    if "accel_y" in r:
      across.append(np.abs(r["accel_y"].value))
    elif wheels.channel in r and "yaw_rate" in r:
      speed, rate = r[wheels.channel], r["yaw_rate"]
      across.append(np.abs(wheels.scale * np.interp(rate.time, speed.time, speed.value) * rate.value))
  return bool(across) and float(np.mean(np.concatenate(across) > _GRIP)) > _OFTEN


def _compared(each: Mapping[str, _T]) -> list[tuple[str, _T]]:
  """The files that can be odd: each of three and more, of two the second, none of one."""
  return list(each.items())[1 if len(each) <= _FILES else 0 :]


def _others(name: str, each: Mapping[str, object]) -> str:
  rest = [other for other in each if other != name]
  return rest[0] if len(rest) == 1 else "the other files"


def _odd(name: str, c: Comparison, others: Sequence[Comparison], than: str, slides: bool) -> list[Finding]:
  channels = (*c.motion.compared, *c.motion.reference)
  sensors = ", or ".join(n for n in dict.fromkeys(channels) if n == channels[0] or n not in ("pose_y", "pose_yaw"))
  cure = (
    f"correct its column in {name}, since [channels] holds for all files, or leave {name} out: a data set is of one car"
  )
  signs, aside = [math.copysign(1.0, o.correlation) for o in others], float(np.median([o.lag.value for o in others]))
  near = abs(c.lag.value - aside) < np.ptp(LAGS)  # driving that repeats itself has the other sign half a round on
  if near and c.correlation * float(np.median(signs)) < 0.0 and abs(sum(signs)) > 0.5 * len(signs):
    said = f"{sensors} has another sign in {name} than in {than}, by {c.motion.name}"
    return [Finding("spoils", channels, f"{said}; {cure}")]
  alike = [o for o in others if scaled(o)]
  if late := _answers_apart(name, c, alike, than):
    return [late]
  if not scaled(c) or len(alike) < min(len(others), _FILES):
    return []
  factor = c.scale.value / float(np.median([o.scale.value for o in alike]))
  if max(factor, 1.0 / factor) > tolerance(c.motion):
    said = f"{sensors} has another unit in {name} than in {than}, or is another car's: by {c.motion.name} the ratio of"
    said += f" the two is {factor:.3g} times theirs"
    if slides and max(factor, 1.0 / factor) < _UNIT:
      slid = (
        "it slides there, and then turns more or less than it steers: if it is the same car, a fit can use it; else"
      )
      return [Finding("beware", channels, f"{said}; {slid} {cure}")]
    return [Finding("spoils", channels, f"{said}; {cure}")]
  nearest = min((c.scale.value / o.scale.value - 1.0 for o in alike), key=abs)
  if c.motion.kinematic and abs(nearest) > max(_OTHERWISE, _SURE * c.scale.std / c.scale.value):
    more = f"{100.0 * abs(factor - 1.0):.0f} % {'more' if factor > 1.0 else 'less'}"
    said = f"{c.motion.compared[0]} reads {more} in {name} than in {than}, against {c.motion.reference[0]}"
    why = "another car, another scale, or a clock that runs otherwise"
    severity: Severity = "beware" if c.motion.reference[0] == "pose_x" else "spoils"  # wheels slip, a gyro does not
    return [Finding(severity, channels, f"{said}: {why}; {cure}")]
  late = dataclasses.replace(c.lag, value=c.lag.value - float(np.median([o.lag.value for o in alike])))
  if c.motion.kinematic and abs(late.value) > _LATE and late.beyond(0.0, _SURE):
    said = f"{c.motion.compared[0]} is {1e3 * abs(late.value):.0f} ± {1e3 * late.std:.0f} ms"
    said += f" {'later' if late.value > 0.0 else 'earlier'} in {name} than in {than}, against"
    said += f" {c.motion.reference[0]}"
    return [Finding("beware", channels, f"{said}; {cure}")]
  return []


def _answers_apart(name: str, c: Comparison, alike: Sequence[Comparison], than: str) -> Finding | None:
  """What to say of a file in which the car answers the steering by more earlier or later than any servo takes."""
  if not alike or not steered(c.motion):
    return None
  late = dataclasses.replace(c.lag, value=c.lag.value - float(np.median([o.lag.value for o in alike])))
  if not (abs(late.value) > LATE and late.beyond(0.0, _SURE)):
    return None
  command, way = c.motion.reference[0], ("earlier", "up") if late.value < 0.0 else ("later", "down")
  said = f"{c.motion.compared[0]} answers {command} {abs(late.value):.2f} s {way[0]} in {name} than in"
  said += f" {than}, which no servo does: {command} has another clock there"
  cure = f"move its column in {name} {way[1]} by that much against the rest, or leave {name} out"
  return Finding("spoils", (command,), f"{said}; {cure}")
