"""Commands that are not what acted: a neutral that is not 0, a switch that was released, a commanded speed as the
measured one, a way driven that is contrary to what was commanded."""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.fitting.noise import ChannelNoise
from calibration.fitting.start_states import STANDS
from calibration.fitting.windows import driven_otherwise
from calibration.log_check.disagreements import Finding, Severity
from calibration.log_check.motions import Wheels
from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.checks.acted import MUCH, Stretch, against, lost_sign, was_commanded
from qcar_twin.recordings.checks.answers import braked_stretches, unanswered_stretches
from qcar_twin.recordings.checks.driving import MOVING
from qcar_twin.recordings.checks.neutral import (
  Neutral,
  drive_neutral,
  least_command,
  steering_neutral,
  switched_command,
)
from qcar_twin.recordings.checks.pushes import pushed_stretches
from qcar_twin.recordings.checks.signs import SIGNED, sizes_near_zero
from qcar_twin.recordings.completed import with_speed
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

PARKED = "the car never drives"
_ALONG = 0.9  # of the way driven, along the heading: within 26 degrees of it
_SECOND = 1.0  # s, over which noise of a sensor of speed is averaged away
_APART = 0.2  # s, between two stretches that are one
_LISTED = 3  # stretches that are named
_WORTH = 1.0  # s, of a part that is worth a recording
_TURN_ROUND = "set offset = 3.14159 on pose_yaw in [channels], added to one that is there"


def command_findings(recordings: Sequence[Recording], cuts: bool = True, scale: float = 1.0) -> list[Finding]:
  """What commands and motion say of each other; nothing where each command acted as it was logged.

  Args:
    cuts: whether stretches to cut out are sought; commands that are seconds late look like such.
    scale: m/s per unit of the measured speed.
  """
  findings = []
  for channel in DRIVE_COMMANDS:
    driven = [r for r in recordings if r.drive_channel == channel and channel in r]
    if driven:
      findings += _drive(driven, channel, cuts, scale)
  if (straight := steering_neutral(recordings)) is not None:
    findings.append(_neutral(straight))
  for channel in ("speed", "motor_speed"):
    if was_commanded(recordings, channel):
      said = f"{channel} stays on levels and leaps, as what was commanded does and no car; map the measured speed, and "
      findings.append(Finding("spoils", (channel,), f"{said}this column as speed_command, in [channels]"))
  return findings


def size_findings(recordings: Sequence[Recording], noise: Mapping[str, ChannelNoise]) -> list[Finding]:
  """Sensors whose sign was lost, as where a logger wrote sizes."""
  findings = []
  for channel in (name for name in SIGNED if name in noise):
    if near := sizes_near_zero(recordings, channel, noise[channel].std):
      said = f"{channel} is never negative, though {near} samples lie within a quarter of its noise of 0"
      cure = "it is a size without a sign: log it with its sign, or leave it out"
      findings.append(Finding("spoils", (channel,), f"{said}: {cure}"))
  return findings


def _drive(recordings: Sequence[Recording], channel: str, cuts: bool, scale: float) -> list[Finding]:
  neutral = drive_neutral(recordings, channel)
  if neutral is not None:
    return [_neutral(neutral)]
  if against(recordings, channel):
    return [_against(recordings[0], channel)]
  alone = [r for r in recordings if not {"pose_x", "pose_y", "pose_yaw"} <= set(r.channels)]  # else the path tells
  if lost := lost_sign(alone, channel):
    return [_signless(lost)]
  if (least := least_command(recordings, channel)) is not None:
    said = f"{channel} never comes near 0, though the car stands for a while: its least is {least:.4g}"
    cure = f"if that is its neutral, set offset = {-least:.6g} on it in [channels]"
    return [Finding("beware", (channel,), f"{said}; {cure}")]
  pushed = _pushed(recordings, channel, scale) if cuts else []
  if cuts and (lost := _idle(recordings, channel)):
    return [*pushed, *lost]
  if (level := switched_command(recordings, channel)) is not None:
    said = f"{channel} is 0 or beyond {level:.4g}, with nothing between, and the car stands for a while under such"
    cure = f"if that is its neutral, set offset = {-level:.6g} on it in [channels], added to one that is there"
    return [*pushed, Finding("beware", (channel,), f"{said}; {cure}")]
  return pushed


def _pushed(recordings: Sequence[Recording], channel: str, scale: float) -> list[Finding]:
  """What the car did without a command."""
  if not (pushed := pushed_stretches(recordings, channel, scale)):
    return []
  said = f"for {_seconds(pushed):.1f} s the car speeds up, or drives off and stops again, under a {channel} of 0"
  why = "it was pushed or carried, rolled down a slope, or followed a command that was not logged"
  return [_cut_out(pushed, recordings, said, why)]


def _idle(recordings: Sequence[Recording], channel: str) -> list[Finding]:
  """Presses that brake, and commands that were not answered."""
  braked = braked_stretches(recordings, channel)
  lost = [one for one in unanswered_stretches(recordings, channel) if not any(_meet(one, other) for other in braked)]
  return [*([_braked(braked, recordings)] if braked else []), *([_unanswered(lost, recordings)] if lost else [])]


def _meet(one: Stretch, other: Stretch) -> bool:
  return one.recording is other.recording and one.start <= other.end and other.start <= one.end


def _braked(braked: Sequence[Stretch], recordings: Sequence[Recording]) -> Finding:
  """Stretches under a press that brakes: many and short, so that all are named."""
  channel = braked[0].channel
  said = (
    f"for {_seconds(braked):.1f} s, {len(braked)} times, the car stands under a first press of a negative {channel}"
  )
  why = "a usual ESC brakes at the first press and reverses at the second"
  spans = _spans(braked)
  named = ", ".join(f"{file} {start:.2f} s to {end:.2f} s" for file, start, end in spans)
  cure = "leave those seconds out by from and to of more [[recording]] entries, or log the ESC's state"
  text = f"{said}, and later presses drive it backwards ({named}): {why}; {cure}"
  return Finding(_severity(braked, recordings), (channel,), text)


def _severity(lost: Sequence[Stretch], recordings: Sequence[Recording]) -> Severity:
  return "spoils" if _seconds(lost) > MUCH * sum(r.duration for r in recordings) else "beware"


def _against(recording: Recording, channel: str) -> Finding:
  speed = "motor_speed" if "motor_speed" in recording else "speed"
  cure = f"one of them has the wrong sign; set scale = -1 on {speed} or on {channel} in [channels]"
  if speed in recording.derived:
    cure = f"set scale = -1 on {channel}, or offset = 3.14159 on pose_yaw where the heading points backwards"
  return Finding("spoils", (channel, speed), f"the car drives backwards under a positive {channel}: {cure}")


def _neutral(neutral: Neutral) -> Finding:
  cure = f"set offset = {-neutral.value:.6g} on {neutral.channel} in [channels], added to one that is there"
  if not neutral.sure:
    said = f"{neutral.why}: a command too small to move the car, or its neutral; if that is its neutral, {cure}"
    return Finding("beware", (neutral.channel,), said)
  said = f"{neutral.channel} has its neutral at {neutral.value:.4g} and not at 0: {neutral.why}; {cure}"
  return Finding("spoils", (neutral.channel,), said)


def _seconds(stretches: Sequence[Stretch]) -> float:
  return sum(stretch.end - stretch.start for stretch in stretches)


def _signless(lost: Sequence[Stretch]) -> Finding:
  first = lost[0]
  speed = "motor_speed" if "motor_speed" in first.recording else "speed"
  file = first.recording.file or first.recording.name
  said = f"{speed} is never negative, and the car drives on for {_seconds(lost):.0f} s under a negative {first.channel}"
  where = (
    f"({file} {first.start:.2f} s to {first.end:.2f} s, and {len(lost) - 1} more)"
    if len(lost) > 1
    else (f"({file} {first.start:.2f} s to {first.end:.2f} s)")
  )
  cure = f'set signed_by = "{first.channel}" on {speed} in [channels], so that it has the sign of the command'
  return Finding("spoils", (speed, first.channel), f"{said} {where}: it has lost the sign of driving backwards; {cure}")


def _unanswered(lost: Sequence[Stretch], recordings: Sequence[Recording]) -> Finding:
  said = (
    f"for {_seconds(lost):.1f} s the car stands, or answers by less than half, under a {lost[0].channel} that drives"
  )
  why = "a battery that died or browned out, a switch that was released, a car that was held, or a speed that stuck"
  return _cut_out(lost, recordings, f"{said} it elsewhere", f"{why}{_fell(lost)}")


def _cut_out(lost: Sequence[Stretch], recordings: Sequence[Recording], said: str, why: str) -> Finding:
  """Stretches that no model can explain, with the cut that leaves nothing of them."""
  spans = _spans(lost)
  named = ", ".join(f"{file} {start:.2f} s to {end:.2f} s" for file, start, end in spans[:_LISTED])
  more = f" and {len(spans) - _LISTED} more" if len(spans) > _LISTED else ""
  file, start, end = spans[0]
  own = [r for r in recordings if (r.file or r.name) == file]
  parts = [f"ends at to = {start:.2f}"] if start - min(r.start for r in own) > _WORTH else []
  parts += [f"begins at from = {end:.2f}"] if max(r.end for r in own) - end > _WORTH else []
  cure = f"leave {file} out" if not parts else f"of {file} a [[recording]] that {' and one that '.join(parts)}"
  return Finding(
    _severity(lost, recordings), (lost[0].channel,), f"{said} ({named}{more}): {why}; cut the stretches out: {cure}"
  )


def _fell(lost: Sequence[Stretch]) -> str:
  """What the battery's voltage was meanwhile, against elsewhere, where it was logged."""
  one = max(lost, key=lambda s: s.end - s.start)
  if (battery := one.recording.battery) is None:
    return ""
  inside = (battery.time >= one.start) & (battery.time <= one.end)
  if not inside.any() or inside.all():
    return ""
  then, else_ = (float(np.median(battery.value[where])) for where in (inside, ~inside))
  return f" (battery_voltage is {then:.3g} V from {one.start:.2f} s to {one.end:.2f} s, elsewhere {else_:.3g} V)"


def _spans(idle: Sequence[Stretch]) -> list[tuple[str, float, float]]:
  """Files, or names where there are none, and seconds; stretches that a cut by time parted are one."""
  spans: list[tuple[str, float, float]] = []
  for i in sorted(idle, key=lambda i: (i.recording.file or i.recording.name, i.start)):
    file = i.recording.file or i.recording.name
    if spans and spans[-1][0] == file and i.start - spans[-1][2] < _APART:
      spans[-1] = (file, spans[-1][1], i.end)
    else:
      spans.append((file, i.start, i.end))
  return spans


def drive_findings(recordings: Sequence[Recording], vehicle: Vehicle) -> list[Finding]:
  """Commands of another kind than the one that the car is said to be driven by."""
  said = next(filter(None, (driven_otherwise(r, vehicle) for r in recordings)), "")
  return [Finding("spoils", (vehicle.motor.channel,), said)] if said else []


def parked_findings(wheels: Wheels, recordings: Sequence[Recording]) -> list[Finding]:
  """A car that never drives: no mean over a second is faster than one that stands."""
  name, means = wheels.channel, [np.zeros(1)]
  for stream in (r[name] for r in recordings if name in r):
    second = ((stream.time - stream.time[0]) / _SECOND).astype(int)
    counts = np.bincount(second)
    means.append(np.bincount(second, stream.value)[counts > 0] / counts[counts > 0])
  top = wheels.scale * float(np.abs(np.concatenate(means)).max())
  if top > STANDS:
    return []
  said = f"{PARKED}: by {name} it reaches {top:.2g} m/s over a second, and nothing can be fitted to that"
  return [Finding("beware", (name,), f"{said}; record it driving, or correct scale of {name} in [channels]")]


def direction_findings(wheels: Wheels, recordings: Sequence[Recording]) -> list[Finding]:
  """A heading that points backwards, or driving in reverse that a speed without a sign reads as forwards.

  Such a speed agrees with the size of the path whichever way the heading points. The path along the heading has a sign.
  Where it is contrary to the drive's command the heading is turned round; else the car did drive backwards. A path that
  does not go along the heading at all, as of exchanged axes, tells neither.
  """
  name = wheels.channel
  by_pose = [_by_pose(r, name) for r in recordings if _whole(r, name)] if wheels.unsigned else []
  along = np.concatenate([r["speed"].value for r in by_pose if "speed" in r] or [np.empty(0)])
  sensed = np.concatenate([r[name].value for r in recordings if name in r] or [np.zeros(1)])
  top = wheels.scale * float(np.percentile(sensed, 99.0))
  drives = top > STANDS  # a pose wanders about a car that stands
  moving = np.abs(along) > MOVING * top
  back = moving & (along < 0.0)
  if not drives or not np.any(back) or not _along_its_path(by_pose, along):
    return []
  share, seconds = float(back.sum() / moving.sum()), float(back.mean()) * sum(r.duration for r in by_pose)
  if share <= MUCH and seconds < _SECOND:
    return []
  said = f"{name} is never negative, and by the pose the car drove backwards for {seconds:.1f} s"
  commands = [c for c in DRIVE_COMMANDS if any(r.drive_channel == c and c not in r.derived for r in by_pose)]
  if any(against([r for r in by_pose if r.drive_channel == c], c) for c in commands):
    who = " and ".join(commands)
    return [
      Finding("spoils", ("pose_yaw", *commands), f"{said}, under {who} forwards: the heading is turned; {_TURN_ROUND}")
    ]
  cure = f"leave {name} out of [channels], since the pose gives the speed with its sign"
  if not commands:
    cure += f"; or, if it drove forwards, {_TURN_ROUND}"
  return [Finding("spoils" if share > MUCH else "beware", (name, "pose_yaw"), f"{said}: {cure}")]


def _along_its_path(recordings: Sequence[Recording], along: np.ndarray) -> bool:
  """Whether the places go along the heading, forwards or backwards."""
  alone = [r.replace(streams={c: r[c] for c in ("pose_x", "pose_y")}) for r in recordings if "speed" in r]
  way = np.concatenate([with_speed(r)[0]["speed"].value for r in alone])
  return float(np.abs(along).mean()) > _ALONG * float(way.mean())


def _whole(recording: Recording, name: str) -> bool:
  return {name, "pose_x", "pose_y", "pose_yaw"} <= set(recording.channels) and name not in recording.derived


def _by_pose(recording: Recording, name: str) -> Recording:
  """The recording with the pose's speed in the sensor's place."""
  return with_speed(recording.replace(streams={c: s for c, s in recording.streams.items() if c != name}))[0]
