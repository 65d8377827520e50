"""Motions that two sensors measure, each as the mean of a rate over short windows.

Whatever is the integral of a rate (heading of yaw rate, path of speed, speed of acceleration) gives the rate's mean
over a window without being differentiated; a rate gives it by being added up. So both sides are filtered alike.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.noise import ChannelNoise
from qcar_twin.recordings.completed import heading_or_course
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
STRAIGHT, TURNING = ("steady", "speeding up", "slowing down"), ("turning left", "turning right")
REGIMES = (*STRAIGHT, *TURNING)
_TURNS, _SPEEDS = 0.5, 0.3  # m/s^2 across and along, from which a window is called by its turn or its change of speed
_FELT = 2.0 * _TURNS  # the same as felt by an accelerometer: neither its zero nor a slope comes to that
_SLOW = 0.1  # m/s, below which a pose hardly tells the way it goes
CLOCK, PLACE = "time", "pose"  # what may be wrong besides a channel: the stamps, the unit of pose_x and pose_y
_DIRECTION = 0.1  # rad, noise of a path's direction where it is told at all
_KEPT = 1.0  # s, for which a last command is believed to be in force
Means = Callable[[Array, float], Array]  # begin of windows (k,) s, length s -> mean of the rate in each, (k,)


@dataclasses.dataclass(frozen=True)
class Wheels:
  """The channel that says how fast the wheels turn, the speed of the car per unit of it, m/s, and whether it never
  carries a sign."""

  channel: str
  scale: float
  unsigned: bool = False

  @classmethod
  def of(cls, vehicle: Vehicle, recordings: Sequence[Recording]) -> "Wheels":
    channel = "motor_speed" if any("motor_speed" in r for r in recordings) else "speed"
    scale = vehicle.gear_ratio * vehicle.wheel_radius if channel == "motor_speed" else 1.0
    return cls(channel, scale, all(r[channel].value.min() >= 0.0 for r in recordings if channel in r))


@dataclasses.dataclass(frozen=True)
class Motion:
  """One motion and the two who measure it.

  Attributes:
    name: what both measure, in words.
    compared, reference: channels; the first of each is who measures, others take part.
    of_compared, of_reference: a recording -> mean rates over windows.
    noise: of both means over windows of so many seconds, in the rate's unit.
    unit: of the rate.
    within: how the car must be driven for the two to be the same motion, of REGIMES.
    kinematic: they are the same by geometry alone, so a lag or a scale is a sensor's; else also how the car answers.
    powers: to which the scale of the two takes a factor on a channel, on the place (PLACE) or on all stamps (CLOCK).
    unbiased: neither of the two has a zero of its own that may be off.
    answers: the one is how the car answers the other, as late as it likes.
    acts: where the reference is a command times what it acts on: a recording -> the mean rates of both, since of stamps
      that are seconds off only the command's are.
  """

  name: str
  compared: tuple[str, ...]
  reference: tuple[str, ...]
  of_compared: Callable[[Recording], Means]
  of_reference: Callable[[Recording], Means]
  noise: Callable[[Mapping[str, ChannelNoise], float], tuple[float, float]]
  unit: str
  within: tuple[str, ...] = REGIMES
  kinematic: bool = False
  powers: Mapping[str, int] = dataclasses.field(default_factory=dict)
  unbiased: bool = False
  answers: bool = False
  acts: Callable[[Recording], tuple[Means, Means]] | None = None

  def measured_in(self, recording: Recording) -> bool:
    return all(name in recording and len(recording[name]) > 1 for name in (*self.compared, *self.reference))


def motions(wheels: Wheels, recordings: Sequence[Recording]) -> list[Motion]:
  """Those of which these recordings hold both sides."""
  wheel, to_speed = wheels.channel, wheels.scale
  pose = ("pose_x", "pose_y", "pose_yaw")
  by_pose = any(wheel in r.derived for r in recordings)
  per_speed = {PLACE: -1, CLOCK: 1} if by_pose else {wheel: -1}  # of a scale whose reference has the speed in it
  known = [
    Motion(
      "turning", ("yaw_rate",), ("pose_yaw",),
      lambda r: _added(r["yaw_rate"]), lambda r: _increments(r["pose_yaw"]),
      lambda n, w: (_mean_noise(n["yaw_rate"], w), _step_noise(n["pose_yaw"], w)),
      "rad/s", kinematic=True, powers={"yaw_rate": 1, "pose_yaw": -1, CLOCK: 1},
    ),
    Motion(
      "driving", (wheel,), pose,
      lambda r: _added(r[wheel], to_speed), lambda r: _path(r, wheels.unsigned),
      lambda n, w: (to_speed * _mean_noise(n[wheel], w), _step_noise(n["pose_x"], w)),
      "m/s", STRAIGHT, kinematic=True, unbiased=True, powers={wheel: 1, PLACE: -1, CLOCK: 1},
    ),
    Motion(
      "speeding up and slowing down", ("accel_x",), (wheel,),
      lambda r: _added(r["accel_x"]), lambda r: _increments(r[wheel], to_speed),
      lambda n, w: (_mean_noise(n["accel_x"], w), to_speed * _step_noise(n[wheel], w)),
      "m/s^2", STRAIGHT, powers=_product_of({"accel_x": 1, CLOCK: 1}, per_speed),
    ),
    Motion(
      "going round", ("accel_y",), (wheel, "yaw_rate"),
      lambda r: _added(r["accel_y"]), lambda r: _product(r[wheel], r["yaw_rate"], to_speed),
      lambda n, w: (_mean_noise(n["accel_y"], w), _mean_noise(n["yaw_rate"], w)),
      "m/s^2", TURNING, powers=_product_of({"accel_y": 1, "yaw_rate": -1}, per_speed),
    ),
    Motion(
      "answering the steering", ("yaw_rate",), ("steering_command", wheel),
      lambda r: _added(r["yaw_rate"]), lambda r: _steered(r, wheels),
      lambda n, w: (_mean_noise(n["yaw_rate"], w), _mean_noise(n[wheel], w) * to_speed),
      "rad/s", powers=_product_of({"yaw_rate": 1, "steering_command": -1}, per_speed),
      acts=lambda r: (_held(r["steering_command"]), _added(r[wheel], to_speed)),
    ),
  ]  # fmt: skip
  heading = any("pose_yaw" in r for r in recordings)
  if not any("yaw_rate" in r for r in recordings):
    known[-2:] = _turned_by_the_pose(known[-2], known[-1], wheels, per_speed, pose[2:] if heading else pose[:2])
  if not by_pose and not heading:
    known[1] = _without_heading(known[1], wheels)
  if by_pose:
    known[1] = _along_the_heading(known[1])
  if wheel == "motor_speed":
    known.insert(2, _rolling(wheels, recordings))
  if wheel == "speed" and any("speed_command" in r and "speed_command" not in r.derived for r in recordings):
    known.append(_following(PLACE if by_pose else "speed"))
  held = [m for m in known if any(m.measured_in(r) for r in recordings)]
  return [_straight_heading(m) for m in held] if any(m.name == "driving" for m in held) else held


def _turned_by_the_pose(
  round_: Motion, answer: Motion, wheels: Wheels, per_speed: Mapping[str, int], by: tuple[str, ...]
) -> tuple[Motion, Motion]:
  """Going round and answering the steering where there is no gyro: as the slope of a heading tells them, or that of the
  path's direction, which no unit of the place changes."""
  wheel, to_speed = wheels.channel, wheels.scale
  scale = {"pose_yaw": 1} if by == ("pose_yaw",) else {}
  noise = lambda n, w: _step_noise(n["pose_yaw"], w) if scale else np.sqrt(2.0) * _DIRECTION / w
  return (
    dataclasses.replace(
      round_,
      reference=(wheel, *by),
      of_reference=lambda r: _turned(r[wheel], heading_or_course(r), to_speed),
      noise=lambda n, w: (_mean_noise(n["accel_y"], w), noise(n, w)),
      powers=_product_of({"accel_y": 1, CLOCK: 1} | {name: -1 for name in scale}, per_speed),
    ),
    dataclasses.replace(
      answer,
      compared=by,
      of_compared=lambda r: _increments(heading_or_course(r)),
      noise=lambda n, w: (noise(n, w), _mean_noise(n[wheel], w) * to_speed),
      powers=_product_of(scale | {"steering_command": -1, CLOCK: -1}, per_speed),
    ),
  )


def _without_heading(driving: Motion, wheels: Wheels) -> Motion:
  """A pose without a heading tells how fast a car goes, in turns, too, and not whether forwards."""
  return dataclasses.replace(
    driving,
    within=REGIMES,
    reference=driving.reference[:2],
    of_compared=lambda r: _size(_added(r[wheels.channel], wheels.scale)),
    of_reference=lambda r: _travelled(r["pose_x"], r["pose_y"]),
  )


def _straight_heading(motion: Motion) -> Motion:
  """A heading along which the path goes has the right scale."""
  return dataclasses.replace(motion, powers={k: v for k, v in motion.powers.items() if k != "pose_yaw"})


def _rolling(wheels: Wheels, recordings: Sequence[Recording]) -> Motion:
  """The motor's speed and another sensor's of a car whose wheels roll: by gear ratio and radius."""
  signed = not wheels.unsigned and any(r["speed"].value.min() < 0.0 for r in recordings if "speed" in r)
  size: Callable[[Means], Means] = (lambda means: means) if signed else _size
  return Motion(
    "rolling", (wheels.channel,), ("speed",),
    lambda r: size(_added(r[wheels.channel], wheels.scale)), lambda r: size(_added(r["speed"])),
    lambda n, w: (wheels.scale * _mean_noise(n[wheels.channel], w), _mean_noise(n["speed"], w)),
    "m/s", STRAIGHT, kinematic=True, unbiased=True, powers={wheels.channel: 1, "speed": -1},
  )  # fmt: skip


def _following(measured: str) -> Motion:
  """A speed that was measured, or that the pose gave, and the one that was commanded: who commands it knows nothing of
  stamps."""
  return Motion(
    "following the commanded speed", ("speed",), ("speed_command",),
    lambda r: _added(r["speed"]), lambda r: _held(r["speed_command"], r["speed"]),
    lambda n, w: (_mean_noise(n["speed"], w), _mean_noise(n["speed"], w)),
    "m/s", powers={measured: 1, "speed_command": -1} | ({CLOCK: -1} if measured == PLACE else {}), answers=True,
  )  # fmt: skip


def _along_the_heading(driving: Motion) -> Motion:
  """A speed that the pose gave agrees with the pose; that its heading is the way it goes is left to compare."""
  return dataclasses.replace(
    driving,
    compared=("pose_yaw",),
    reference=("pose_x", "pose_y"),
    of_compared=lambda r: _path(r, True),
    of_reference=lambda r: _travelled(r["pose_x"], r["pose_y"]),
    noise=lambda n, w: (_step_noise(n["pose_x"], w), _step_noise(n["pose_x"], w)),
    within=REGIMES,
    powers={},
  )


def _product_of(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
  """Powers of a product, those that cancel left out."""
  powers = {name: one.get(name, 0) + other.get(name, 0) for name in (*one, *other)}
  return {name: power for name, power in powers.items() if power}


def _size(means: Means) -> Means:
  return lambda begin, length: np.abs(means(begin, length))


def _travelled(x: Stream, y: Stream) -> Means:
  """Speed of a place whichever way it goes; NaN where it is slow, and noise has no direction."""
  at = lambda stream, time: np.interp(time, stream.time, stream.value)

  def mean(begin: Array, length: float) -> Array:
    end = begin + length
    speed = _inside(x, begin, length, np.hypot(at(x, end) - at(x, begin), at(y, end) - at(y, begin))) / length
    return np.where(speed > _SLOW, speed, np.nan)

  return mean


def regimes(wheels: Wheels, recording: Recording, begin: Array, length: float) -> NDArray[np.str_]:
  """How the car was driven in windows, one of REGIMES each, (k,)."""
  label = np.full(len(begin), REGIMES[0], dtype="U16")
  some = lambda channel: channel in recording and len(recording[channel]) > 1
  if not some(wheels.channel):
    return label
  speed, change = (f(recording[wheels.channel], wheels.scale)(begin, length) for f in (_added, _increments))
  rate = np.zeros(len(begin))
  if some("yaw_rate"):
    rate = _added(recording["yaw_rate"])(begin, length)
  elif (heading := heading_or_course(recording)) is not None:
    rate = np.nan_to_num(_increments(heading)(begin, length))
  across = speed * rate
  if some("accel_y"):  # a gyro that reads too little hides every turn
    felt = _added(recording["accel_y"])(begin, length)
    across = np.where(np.abs(across) > _TURNS, across, np.where(np.abs(felt) > _FELT, felt, across))
  for name, there in (
    ("speeding up", change > _SPEEDS),
    ("slowing down", change < -_SPEEDS),
    ("turning left", across > _TURNS),
    ("turning right", across < -_TURNS),
  ):
    label[there] = name
  return label


def _added(stream: Stream, scale: float = 1.0) -> Means:
  """Means of a rate that was sampled."""
  area = np.r_[0.0, np.cumsum(0.5 * np.diff(stream.time) * (stream.value[1:] + stream.value[:-1]))]

  def integral(time: Array) -> Array:
    i = np.clip(np.searchsorted(stream.time, time, side="right") - 1, 0, len(stream) - 2)
    t, dt = time - stream.time[i], stream.time[i + 1] - stream.time[i]
    slope = (stream.value[i + 1] - stream.value[i]) / dt
    return area[i] + t * (stream.value[i] + 0.5 * slope * t)

  return lambda begin, length: (
    scale * _inside(stream, begin, length, integral(begin + length) - integral(begin)) / length
  )


def _increments(stream: Stream | None, scale: float = 1.0) -> Means:
  """Means of the rate of something that was sampled; NaN without it."""
  if stream is None:
    return lambda begin, length: np.full(len(begin), np.nan)
  at = lambda time: np.interp(time, stream.time, stream.value)
  return lambda begin, length: scale * _inside(stream, begin, length, at(begin + length) - at(begin)) / length


def _path(recording: Recording, unsigned: bool) -> Means:
  """Forward speed from poses: displacements along the heading of the window's middle, or their size."""
  x, y, yaw = (recording[name] for name in ("pose_x", "pose_y", "pose_yaw"))
  at = lambda stream, time: np.interp(time, stream.time, stream.value)

  def mean(begin: Array, length: float) -> Array:
    heading, end = at(yaw, begin + 0.5 * length), begin + length
    moved = np.cos(heading) * (at(x, end) - at(x, begin)) + np.sin(heading) * (at(y, end) - at(y, begin))
    known = (begin >= yaw.time[0]) & (end <= yaw.time[-1])
    return np.where(known, _inside(x, begin, length, np.abs(moved) if unsigned else moved), np.nan) / length

  return mean


def _product(speed: Stream, rate: Stream, scale: float) -> Means:
  """Centripetal acceleration: mean of speed times yaw rate."""
  time = rate.time[(rate.time >= speed.time[0]) & (rate.time <= speed.time[-1])]
  if len(time) < 2:
    return lambda begin, length: np.full(len(begin), np.nan)
  return _added(Stream(time, scale * np.interp(time, speed.time, speed.value) * rate.at(time)))


def _turned(speed: Stream, heading: Stream | None, scale: float) -> Means:
  """Centripetal acceleration: mean speed times the heading's change."""
  speeds, turns = _added(speed, scale), _increments(heading)
  return lambda begin, length: speeds(begin, length) * turns(begin, length)


def _held(command: Stream, other: Stream | None = None) -> Means:
  """A command, which keeps its value, while another channel has values, or as long as it is believed."""
  begin, end = command.time[0], command.time[-1] + _KEPT
  first, last = (begin, end) if other is None else (other.time[0], other.time[-1])
  time = np.arange(max(first, begin), min(last, end), 0.01)
  return _added(Stream(time, command.at(time))) if len(time) > 1 else lambda begin, length: np.full(len(begin), np.nan)


def _steered(recording: Recording, wheels: Wheels) -> Means:
  """Speed times commanded angle, to which the yaw rate of a slow car is proportional."""
  speed, command = recording[wheels.channel], recording["steering_command"]
  time = np.arange(max(speed.time[0], command.time[0]), min(speed.time[-1], command.time[-1] + _KEPT), 0.01)
  if len(time) < 2:
    return lambda begin, length: np.full(len(begin), np.nan)
  return _added(Stream(time, wheels.scale * np.interp(time, speed.time, speed.value) * command.at(time)))


def _inside(stream: Stream, begin: Array, length: float, value: Array) -> Array:
  """NaN where a window lies outside a stream or in a gap of it."""
  step = np.median(np.diff(stream.time))
  first = np.searchsorted(stream.time, begin, side="right")
  last = np.searchsorted(stream.time, begin + length, side="right")
  whole = (begin >= stream.time[0]) & (begin + length <= stream.time[-1])
  dense = (last - first) >= 0.5 * length / step - 1.0
  return np.where(whole & dense, value, np.nan)


def _mean_noise(noise: ChannelNoise, window: float) -> float:
  """Of the mean of white noise over a window."""
  return noise.std / np.sqrt(max(window * noise.rate, 1.0))


def _step_noise(noise: ChannelNoise, window: float) -> float:
  """Of a difference over a window, divided by it."""
  return np.sqrt(2.0) * noise.std / window
