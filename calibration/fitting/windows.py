"""Recordings cut into stretches that simulate side by side, each started from what was measured.

A free run over minutes lets a small force error grow into a large one; a restart every few samples
sees nothing but noise. Stretches of a few seconds, started from the measured speed and yaw rate,
keep both in bounds. The first `warm_up` seconds of a stretch that starts in mid-recording are
simulated but not scored: hidden states (servo, tyre, play) settle there.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.informative import chosen, regressors
from calibration.fitting.noise_floor import driving_noise
from calibration.fitting.start_states import STANDS, measured_start, pushed, read_off_pose
from qcar_twin.kinematics import road_speed, rolling_radius
from qcar_twin.plant import LEAD, START, Segments
from qcar_twin.recordings.dataset import in_order
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_SPAN = 0.1  # s: before and after a stretch's beginning, between which its states' rates are taken
_FOR_A_SLOPE = 3  # samples
_ON_ITS_WAY = 0.3  # s before a stretch of which commands are known to it: the longest delay of the catalogue
_GOLDEN = 0.618  # of a turn between one recording's phase and the next one's, so that beginnings and ends take turns


@dataclasses.dataclass(frozen=True)
class Cut:
  """How recordings are cut.

  Attributes:
    length: longest scored stretch, s.
    warm_up: unscored lead-in of stretches that start in mid-recording, s.
    period: control period, s.
    most: seconds of driving that are kept at most; inf for all.
    evenly: they are spread evenly; else half of them are chosen for what they tell.
    command_shift: control periods by which commands act later than logged (the timing convention); may be negative.
  """

  length: float = 6.0
  warm_up: float = 0.4
  period: float = 0.01
  most: float = np.inf
  evenly: bool = False
  command_shift: int = 0


DEFAULT_CUT = Cut()


@dataclasses.dataclass(frozen=True)
class Stretches:
  """Segments and the part of each that is scored: from `first` to `last`, s, recording time, (S,)."""

  segments: Segments
  first: Array
  last: Array


def cut_recordings(recordings: Sequence[Recording], vehicle: Vehicle, cut: Cut = DEFAULT_CUT) -> Stretches:
  """Cut recordings into padded segments with measured start states.

  Args:
    recordings: in the order they were driven; heat and charge are carried along this order.
    vehicle: numbers of the car (gear_ratio, wheel_radius, cg_to_front, cg_to_rear) and what drives it.
    cut: lengths and timing.

  Raises:
    ValueError: two recordings have one name, or none is long enough to simulate.
  """
  names = [recording.name for recording in recordings]
  if twice := sorted({name for name in names if names.count(name) > 1}):
    raise ValueError(f"{names.count(twice[0])} recordings are called '{twice[0]}': give each a name of its own")
  pieces = [piece for index, recording in enumerate(recordings) for piece in _pieces(recording, index, vehicle, cut)]
  if not pieces:
    raise ValueError(
      f"no recording is long enough to simulate; at least 0.2 s with a {vehicle.motor.channel} are needed"
    )
  pieces = _thinned(pieces, recordings, cut)
  history = [np.array(r.before) for r in in_order(recordings)]
  steps = np.array([len(p.commands) for p in pieces])
  longest, by_pose = int(steps.max()), np.stack([read_off_pose(recordings[p.index]) for p in pieces])
  commands = np.stack([_pad(p.commands, longest) for p in pieces])
  segments = Segments(
    commands=commands,
    start=np.stack([p.start for p in pieces]),
    steps=steps,
    period=cut.period,
    recording=tuple(recordings[p.index].name for p in pieces),
    offset=np.array([p.offset for p in pieces]),
    history=np.stack([history[p.index] + p.spent for p in pieces]),
    pose=np.stack([_pad(p.pose, longest + 1) for p in pieces]),
    wheel_angle=np.stack([_pad(p.wheel_angle, longest + 1) for p in pieces]),
    start_rate=np.stack([p.rate for p in pieces]),
    start_push=np.array([p.push for p in pieces]),
    lead=np.stack([p.lead for p in pieces]),
    before=np.stack([p.before for p in pieces]),
    start_by_pose=by_pose if by_pose.any() else None,
  )
  return Stretches(segments, np.array([p.first for p in pieces]), np.array([p.last for p in pieces]))


@dataclasses.dataclass(frozen=True)
class _Piece:
  index: int
  commands: Array
  pose: Array
  wheel_angle: Array
  speed: Array
  heading: Array
  start: Array
  rate: Array
  push: float
  lead: Array
  before: Array
  offset: float
  first: float
  last: float
  spent: Array


def _pieces(recording: Recording, index: int, vehicle: Vehicle, cut: Cut) -> list[_Piece]:
  time, commands = driven(recording, vehicle, cut.period)
  commands = shift_commands(commands, cut.command_shift)
  duration = len(time) * cut.period
  if duration < 0.2:
    return []
  # all stretches ride in one batch as long as the longest, so none may stick out by much
  count = max(1, int(np.ceil(duration / cut.length - 0.02)))
  edges = np.linspace(0, len(time), count + 1).round().astype(int)
  grid = np.append(time, time[-1] + cut.period)
  pose, wheel_angle = pose_on(recording, grid), wheel_angle_on(recording, grid, vehicle)
  speed, noise, pieces = _speed_on(recording, time, vehicle), driving_noise([recording]), []
  for low, high in zip(edges[:-1], edges[1:], strict=True):
    begin = max(0, low - int(round(cut.warm_up / cut.period))) if low else 0
    spent = np.array([begin * cut.period, float(np.sum(commands[:begin, 0] ** 2)) * cut.period])
    start_at = lambda t, begin=begin: measured_start(recording, t, vehicle, commands[begin, 1], begin == 0, noise)
    pieces.append(
      _Piece(
        index=index,
        commands=commands[begin:high],
        pose=pose[begin : high + 1],
        wheel_angle=wheel_angle[begin : high + 1],
        speed=speed[begin:high],
        heading=np.nan_to_num(pose[begin:high, 2]),
        start=start_at(float(time[begin])),
        rate=_rate(start_at, float(time[begin]), begin == 0),
        push=pushed(recording, float(time[begin]), noise),
        lead=_lead(commands[:, 0], speed, begin, cut.period, vehicle),
        before=_before(commands, begin, round(_ON_ITS_WAY / cut.period)),
        offset=float(time[begin]),
        first=float(time[low]),
        last=float(time[high - 1] + cut.period),
        spent=spent,
      )
    )
  return pieces


def driven(recording: Recording, vehicle: Vehicle, period: float) -> tuple[Array, Array]:
  """Time (T,) [s] on a grid of `period`, and what drove the car: the drive's command in its unit and steering [rad],
  means over the period after each time.

  A duty is that of the vehicle's supply_voltage: it is what was commanded times the logged battery over that.

  Raises:
    ValueError: the recording holds the command of another kind of drive.
  """
  if said := driven_otherwise(recording, vehicle):
    raise ValueError(said)
  return recording.mean_commands(period, vehicle.commands, vehicle.supply_voltage)


def driven_otherwise(recording: Recording, vehicle: Vehicle) -> str:
  """That a recording holds the command of another kind of drive than the car's, and the cure; "" where it does not."""
  wanted, there = vehicle.motor.channel, recording.drive_channel
  if there == wanted or there not in recording or wanted in recording:
    return ""
  return (
    f"recording '{recording.name}' was driven by {there}, but {vehicle.name} is driven by {wanted} (drive ="
    f' "{vehicle.drive}"); correct drive in [vehicle] of dataset.toml, or name a twin of this car where one was named'
  )


def _thinned(pieces: list[_Piece], recordings: Sequence[Recording], cut: Cut) -> list[_Piece]:
  """At most `cut.most` seconds of pieces: half of them, or two of every recording, evenly spread, and those that add
  most to them.

  A twin that lacks physics is bent by whatever it is fitted to, so what is kept must also be like the whole; of those
  that are fitted and those that judge the same share is kept.
  """
  length = sum(len(p.commands) for p in pieces) * cut.period / len(pieces)
  room = max(1, int(cut.most / length)) if np.isfinite(cut.most) else len(pieces)
  if room >= len(pieces):
    return pieces
  recording = np.array([p.index for p in pieces])
  if cut.evenly:
    return [pieces[i] for i in _evenly(recording, room)]
  kept: set[int] = set()
  roles = np.array([recordings[i].role for i in recording])
  for role in dict.fromkeys(roles.tolist()):
    own = np.flatnonzero(roles == role)
    share = max(1, round(room * len(own) / len(pieces)))
    each = 2 * len(np.unique(recording[own]))
    spread = _evenly(recording[own], min(share, max((share + 1) // 2, each)))
    shown = [
      regressors(p.commands, p.speed, p.heading, cut.period, float(p.spent[1])) for p in (pieces[i] for i in own)
    ]
    kept |= {int(own[i]) for i in chosen(shown, share, spread)}
  return [pieces[i] for i in sorted(kept)]


def _evenly(recording: NDArray[np.int64], room: int) -> NDArray[np.int64]:
  """So many of the pieces of recordings, evenly spread; at least one of every recording where there is room.

  Beginnings alone would not do: steps in steering come later, and a twin fitted without them has tyres at will.
  """
  counts = np.unique(recording, return_counts=True)[1]
  if room < 2 * len(counts):
    return spread_evenly(len(recording), room, 0.5)
  kept, first = [], 0
  for k, (count, take) in enumerate(zip(counts, _allotted(counts, room), strict=True)):
    kept.append(first + spread_evenly(count, take, _GOLDEN * k % 1.0))
    first += count
  return np.concatenate(kept)


def spread_evenly(count: int, take: int, phase: float) -> NDArray[np.int64]:
  """So many of `count` indices, evenly spread; the phase within [0, 1) says where the first lies."""
  return ((np.arange(take) + phase) * count / take).astype(np.int64)


def _allotted(counts: NDArray[np.int64], room: int) -> NDArray[np.int64]:
  """How many pieces of each recording are kept: the same share of all, but at least one, and `room` at most in all."""
  low, high = 0.0, 1.0
  for _ in range(30):
    share = 0.5 * (low + high)
    low, high = (share, high) if np.maximum(1, share * counts).astype(int).sum() <= room else (low, share)
  return np.maximum(1, low * counts).astype(np.int64)


def shift_commands(commands: Array, command_shift: int) -> Array:
  """Commands (T, 2) moved later by whole periods (earlier if negative); the ends are held."""
  if command_shift == 0:
    return commands
  index = np.clip(np.arange(len(commands)) - command_shift, 0, len(commands) - 1)
  return commands[index]


def _rate(start_at: Callable[[float], Array], time: float, at_beginning: bool) -> Array:
  """How fast the measured states change at a time, per s, (7,); a car that waits to be driven stands."""
  if at_beginning and start_at(time)[START.index("velocity_x")] == 0.0:
    return np.zeros(len(START))
  before = 0.0 if at_beginning else _SPAN
  return (start_at(time + _SPAN) - start_at(time - before)) / (_SPAN + before)


def _lead(command: Array, speed: Array, begin: int, period: float, vehicle: Vehicle) -> Array:
  """How the car was driven in the 0.2 s before a stretch, (4,), in the order of LEAD; after, where a recording begins.

  Args:
    command, speed: of every control period, (T,), the speed in m/s.  begin: the stretch's first period.
  """
  count = max(_FOR_A_SLOPE, round(2.0 * _SPAN / period))
  near = np.arange(begin, begin + count) if begin < _FOR_A_SLOPE else np.arange(max(0, begin - count), begin)
  near = near[near < len(command)]
  moving = speed[near[:1]] if begin < _FOR_A_SLOPE else speed[near]
  if len(near) < _FOR_A_SLOPE or np.abs(moving).max() < STANDS:
    return np.full(len(LEAD), np.nan)
  when, turning = period * (near - begin), speed[near] / rolling_radius(vehicle)
  rise = np.polyfit(when, turning, 1)[0]
  return np.array([np.mean(command[near]), np.mean(turning), rise, when.mean()], dtype=np.float64)


def _before(commands: Array, begin: int, count: int) -> Array:
  """The `count` commands before a period, (count, 2), the newest last; NaN before the first."""
  known = commands[max(0, begin - count) : begin]
  return np.concatenate([np.full((count - len(known), 2), np.nan), known])


def _speed_on(recording: Recording, time: Array, vehicle: Vehicle) -> Array:
  """Measured speed at times, m/s; 0 without a channel that says it."""
  at = lambda name: np.interp(time, recording[name].time, recording[name].value)
  if "motor_speed" in recording.channels:
    return np.asarray(road_speed(at("motor_speed"), vehicle))
  return at("speed") if "speed" in recording.channels else np.zeros(len(time))


def pose_on(recording: Recording, time: Array) -> Array:
  """Measured x, y, yaw at times, (len(time), 3); NaN where a channel is missing."""
  pose = np.full((len(time), 3), np.nan)
  for column, name in enumerate(("pose_x", "pose_y", "pose_yaw")):
    if name in recording.channels:
      stream = recording[name]
      pose[:, column] = np.interp(time, stream.time, stream.value)
  return pose


def wheel_angle_on(recording: Recording, time: Array, vehicle: Vehicle) -> Array:
  """Angle the wheels have turned since time[0] by the encoder, rad, (len(time),); NaN without one.

  theta = gear_ratio int w dt over the encoder's own samples (trapezoids). A gap is bridged by a straight line; before
  the first and after the last sample the nearest speed holds.
  """
  if "motor_speed" not in recording.channels:
    return np.full(len(time), np.nan)
  stream = recording["motor_speed"]
  at = np.union1d(stream.time, time)
  speed = np.interp(at, stream.time, stream.value)
  angle = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(at)))
  turned = np.interp(time, at, angle)
  return vehicle.gear_ratio * (turned - turned[0])


def _pad(values: Array, length: int) -> Array:
  """Repeat the last row until there are `length` rows; a padded command holds its last value."""
  return np.concatenate([values, np.repeat(values[-1:], length - len(values), axis=0)])
