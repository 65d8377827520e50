"""Readings of a channel that are tried where two sensors of one motion do not agree: sign, axis, period, frame, unit.

Each alternative rewrites channels of the recordings; the comparison is then made again. Which one makes the two agree
is the cure; where none does, which were tried is said.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.noise import ChannelNoise
from calibration.log_check.motions import Motion, Wheels, motions
from calibration.log_check.pairs import Comparison, compare
from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.checks.acted import against
from qcar_twin.recordings.recording import Recording, Stream

Array = NDArray[np.float64]
_AGREE = 0.9  # correlation from which an alternative makes two sensors agree
_NEAR = 1.5  # factor within which their scale must then be 1
_TURN = math.tau


@dataclasses.dataclass(frozen=True)
class Alternative:
  """Another reading of a log.

  Attributes:
    name: what was changed, in words.
    cure: what to write in dataset.toml.
    apply: a recording -> the recording read so.
    needs: channels that it changes.
    partial: whether it believes a part of the channel alone, so that one which believes all of it goes first.
  """

  name: str
  cure: str
  apply: Callable[[Recording], Recording]
  needs: tuple[str, ...]
  partial: bool = False


def agreeing(
  motion: Motion, wheels: Wheels, recordings: Sequence[Recording], noise: Mapping[str, ChannelNoise]
) -> tuple[list[tuple[Alternative, Comparison]], list[str]]:
  """Alternatives that make the two sensors of a motion agree, best first, and the names of all that were tried.

  One that parts two others that geometry ties and that agree, or by which the car drives backwards under its command,
  is none, unless there is no other. Of several those stay that mend most of the other motions that disagree.
  """
  tried = compared_so(motion, wheels, recordings, noise)
  good = [pair for pair in tried if _agree(pair[1])]
  kept = [pair for pair in good if not _parts_others(pair[0], motion, wheels, recordings, noise)] if good[1:] else good
  kept = kept or good
  kept = [pair for pair in kept if not pair[0].partial] or kept
  if kept[1:]:
    mended = [_mended(pair[0], motion, wheels, recordings, noise) for pair in kept]
    kept = [pair for pair, count in zip(kept, mended, strict=True) if count == max(mended)]
  return kept, [alternative.name for alternative, _ in tried]


def _mended(
  alternative: Alternative,
  motion: Motion,
  wheels: Wheels,
  recordings: Sequence[Recording],
  noise: Mapping[str, ChannelNoise],
) -> int:
  """Other motions of which two sensors disagree as they are read, and agree so."""
  count = 0
  for other, held in _touched(alternative, motion, wheels, recordings):
    if not _agree(compare(other, wheels, held, noise)):
      count += _agree(compare(other, wheels, [alternative.apply(r) for r in held], noise))
  return count


def _parts_others(
  alternative: Alternative,
  motion: Motion,
  wheels: Wheels,
  recordings: Sequence[Recording],
  noise: Mapping[str, ChannelNoise],
) -> bool:
  """Whether two sensors of another motion, which geometry ties and which agree as they are read, no longer do."""
  for other, held in _touched(alternative, motion, wheels, recordings):
    if other.kinematic and _agree(compare(other, wheels, held, noise)):
      if not _agree(compare(other, wheels, [alternative.apply(r) for r in held], noise)):
        return True
  return _reverses(alternative, recordings)


def _touched(
  alternative: Alternative, motion: Motion, wheels: Wheels, recordings: Sequence[Recording]
) -> Iterator[tuple[Motion, list[Recording]]]:
  """Other motions that an alternative rewrites a channel of, with the recordings that measure it."""
  for other in motions(dataclasses.replace(wheels, unsigned=False), recordings):
    if other.name == motion.name or not {*other.compared, *other.reference} & set(alternative.needs):
      continue
    held = [r for r in recordings if other.measured_in(r) and set(alternative.needs) <= set(r.channels)]
    if held:
      yield other, held


def _reverses(alternative: Alternative, recordings: Sequence[Recording]) -> bool:
  """Whether the car, which drives forwards under its command as it is read, would then drive backwards."""
  for channel in DRIVE_COMMANDS:
    held = [r for r in recordings if r.drive_channel == channel and set(alternative.needs) <= set(r.channels)]
    if held and not against(held, channel) and against([alternative.apply(r) for r in held], channel):
      return True
  return False


def compared_so(
  motion: Motion, wheels: Wheels, recordings: Sequence[Recording], noise: Mapping[str, ChannelNoise]
) -> list[tuple[Alternative, Comparison]]:
  """The comparison by every alternative that these recordings allow, most alike first."""
  takes = {*motion.compared, *motion.reference}
  forward = dataclasses.replace(wheels, unsigned=False)  # by its size alone a path to the left is one to the right
  motion = next((m for m in motions(forward, recordings) if m.name == motion.name), motion)
  tried = [a for a in _ALTERNATIVES if takes & set(a.needs) and _all_hold(a, motion, recordings)]
  held = [r for r in recordings if motion.measured_in(r)]
  made = [(a, compare(motion, wheels, [a.apply(r) for r in held], noise)) for a in tried]
  return sorted(made, key=lambda pair: -pair[1].correlation if not pair[1].why_not else math.inf)


def _agree(c: Comparison) -> bool:
  return not c.why_not and c.correlation > _AGREE and _of_one_size(c)


def _all_hold(alternative: Alternative, motion: Motion, recordings: Sequence[Recording]) -> bool:
  return all(set(alternative.needs) <= set(r.channels) for r in recordings if motion.measured_in(r))


def _of_one_size(comparison: Comparison) -> bool:
  """Steering's scale is the car's, one over its wheelbase."""
  return comparison.motion.reference[0] == "steering_command" or 1.0 / _NEAR < comparison.scale.value < _NEAR


def _rewritten(**changes: Callable[[Array], Array]) -> Callable[[Recording], Recording]:
  def apply(recording: Recording) -> Recording:
    streams = dict(recording.streams)
    for channel, change in changes.items():
      streams[channel] = Stream(streams[channel].time, change(streams[channel].value))
    return recording.replace(streams=streams)

  return apply


def _exchanged(one: str, other: str) -> Callable[[Recording], Recording]:
  return lambda r: r.replace(streams={**r.streams, one: r.streams[other], other: r.streams[one]})


def _unwrapped(period: float, scale: float = 1.0) -> Callable[[Array], Array]:
  return lambda value: scale * np.unwrap(np.mod(value, period), period=period)


def _flip(channel: str) -> Alternative:
  return Alternative(
    f"{channel} with the other sign",
    f"set scale = -1 on {channel} in [channels], times one that is there",
    _rewritten(**{channel: lambda v: -v}),
    (channel,),
  )


def _turned(name: str, angle: float) -> Alternative:
  cure = f"set offset = {angle:.6g} on pose_yaw in [channels], added to one that is there"
  return Alternative(name, cure, _rewritten(pose_yaw=lambda v: v + angle), ("pose_yaw",))


def _exchange(one: str, other: str) -> Alternative:
  return Alternative(
    f"{one} and {other} exchanged",
    f"exchange the columns of {one} and {other} in [channels]",
    _exchanged(one, other),
    (one, other),
  )


def _compass(value: Array) -> Array:
  """A heading from north, clockwise, from one from east, counter-clockwise, and the other way round."""
  return 0.25 * _TURN - value


def _into_the_car(recording: Recording) -> Recording:
  """Accelerations along the place's axes, as a motion capture or a simulator has them, turned into the car's."""
  x, y, yaw = (recording[name] for name in ("accel_x", "accel_y", "pose_yaw"))
  heading, across = yaw.interpolate(x.time), y.interpolate(x.time)
  there = np.isfinite(heading) & np.isfinite(across)
  time, heading = x.time[there], heading[there]
  cos, sin, along, across = np.cos(heading), np.sin(heading), x.value[there], across[there]
  turned = {"accel_x": Stream(time, cos * along + sin * across), "accel_y": Stream(time, cos * across - sin * along)}
  return recording.replace(streams={**recording.streams, **turned})


_ALTERNATIVES = (
  *(_flip(name) for name in ("yaw_rate", "accel_x", "accel_y", "steering_command", "speed", "motor_speed")),
  Alternative(
    "pose_yaw in degrees",
    "set scale = 0.0174533 on pose_yaw in [channels], times one that is there",
    _rewritten(pose_yaw=_unwrapped(360.0, _TURN / 360.0)),
    ("pose_yaw",),
  ),
  Alternative(
    "pose_yaw repeating every half turn",
    "record the heading over the whole turn, or leave pose_yaw out of [channels]",
    _rewritten(pose_yaw=_unwrapped(0.5 * _TURN)),
    ("pose_yaw",),
    partial=True,
  ),
  Alternative(
    "pose_yaw repeating every turn",
    "set wrap = true on pose_yaw in [channels]",
    _rewritten(pose_yaw=_unwrapped(_TURN)),
    ("pose_yaw",),
  ),
  Alternative(
    "pose_yaw a compass's, clockwise from north",
    "set scale = -1, offset = 1.5708 on pose_yaw in [channels], the scale times one that is there",
    _rewritten(pose_yaw=_compass),
    ("pose_yaw",),
  ),
  _turned("pose_yaw a quarter turn further left", 0.25 * _TURN),
  _turned("pose_yaw a quarter turn further right", -0.25 * _TURN),
  _turned("pose_yaw turned round", 0.5 * _TURN),
  Alternative(
    "pose_y with the other sign",
    "set scale = -1 on pose_y in [channels], times one that is there",
    _rewritten(pose_y=lambda v: -v),
    ("pose_y",),
  ),
  Alternative(
    "pose_y and pose_yaw with the other sign",
    "set scale = -1 on pose_y and on pose_yaw in [channels], times those that are there",
    _rewritten(pose_y=lambda v: -v, pose_yaw=lambda v: -v),
    ("pose_y", "pose_yaw"),
  ),
  _exchange("pose_x", "pose_y"),
  _exchange("accel_x", "accel_y"),
  Alternative(
    "accel_x and accel_y exchanged and accel_x with the other sign",
    "exchange the columns of accel_x and accel_y in [channels], and set scale = -1 on accel_x, times one that is there",
    lambda r: _rewritten(accel_x=lambda v: -v)(_exchanged("accel_x", "accel_y")(r)),
    ("accel_x", "accel_y"),
  ),
  Alternative(
    "accel_x and accel_y exchanged and accel_y with the other sign",
    "exchange the columns of accel_x and accel_y in [channels], and set scale = -1 on accel_y, times one that is there",
    lambda r: _rewritten(accel_y=lambda v: -v)(_exchanged("accel_x", "accel_y")(r)),
    ("accel_x", "accel_y"),
  ),
  Alternative(
    "accel_x and accel_y along the axes of the place",
    "turn accel_x and accel_y by -pose_yaw into the car's axes in the log, or leave both out of [channels]",
    _into_the_car,
    ("accel_x", "accel_y", "pose_yaw"),
  ),
)
