"""How an IMU lies in the car and in which unit it counts: gravity says which of its axes is upright and what 1 g reads,
speeding up which axis points forwards.

With three accelerometers, specific force f has f = +g upwards at rest, and forwards f = d(speed)/dt. The third axis is
left = up x forward, and the yaw rate is what the gyro says about the upright axis. Of a gyro alone, and of one beside
no heading, the sign is that of f_left = speed times yaw rate: flight controllers count yaw to the right.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.channels import CHANNELS, GRAVITY
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, scale
from qcar_twin.recordings.first_dataset.heading import contrary, goes_with
from qcar_twin.recordings.first_dataset.refine import recordings_of
from qcar_twin.recordings.first_dataset.scales.series import correlation
from qcar_twin.recordings.first_dataset.scales.turning import Turning
from qcar_twin.recordings.recording import Recording
from qcar_twin.recordings.unit_names import UNITS, unit_of, words_of

Array = NDArray[np.float64]
_ACCELEROMETERS = {"acc", "accel", "acl", "acceleration", "accelerometer", "a"}
_GYROS = {"gyro", "gyr", "gyroscope", "angular", "omega", "g", "w"}
_AXES = "xyz"
_PLACE = ("pose_x", "pose_y")
# what 1 g reads: m/s^2, g, mg, and the counts of accelerometers of 16 bits with ranges of 2, 4, 8 and 16 g
_READS = {GRAVITY: "m/s^2", 1.0: "g", 1000.0: "mg"} | {
  count: f"counts of {count:g} a g" for count in (16384.0, 8192.0, 4096.0, 2048.0)
}
_LIKE_GRAVITY = 0.1  # of it, within which a length is one: offsets of cheap accelerometers reach half of that
_UPRIGHT = 0.8  # of gravity, which an upright axis feels: a mount tilted by 37 deg
_BIN = 0.25  # s, over which accelerations and the change of speed are compared
_LEAST = 20  # bins that a direction is worth
ALIKE, _CLEARLY = 0.6, 2.0  # correlation of a force with its motion, and times that of the other axis


@dataclass(frozen=True)
class _Imu:
  """Names of the columns about x, y, z, and what one of the accelerometers' units is in m/s^2."""

  accelerometers: tuple[str, str, str]
  gyros: tuple[str, str, str] | None
  scale: float


@dataclass(frozen=True)
class _Mount:
  """Axes 0 to 2 of the IMU that lie along the car's, and their signs: specific force forwards and to the left is
  `signs` times what these accelerometers say, the yaw rate what the upright gyro does."""

  forward: int
  left: int
  up: int
  signs: tuple[float, float, float]
  reversed: bool  # whether the accelerometers say minus the specific force


def settle_gravity(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Scale accelerometers whose names say no unit by gravity, where all three axes of one sensor were logged."""
  taken = {guesses[name].column: guesses[name] for name in ("accel_x", "accel_y") if name in guesses}
  for triad in _triads(columns, _ACCELEROMETERS).values():
    names = (triad[0], triad[1], triad[2])
    own = [guess for column, guess in taken.items() if column in names]
    if not own or any(_named(name) for name in names) or (told := _by_gravity(columns, names, taken)) is None:
      continue
    for guess in own:
      by_size = Guess(guess.channel, guess.column)
      scale(columns, by_size)
      if by_size.why or told[0] != 1.0:
        guess.why = [*(why for why in guess.why if why not in by_size.why), told[1]]
      guess.scale, guess.named = told[0], True


def settle_imu(columns: Columns, guesses: dict[str, Guess]) -> bool:
  """Settle how an IMU lies: by gravity, else by its motion; returns whether it was turned, for it lies upside down."""
  settle_mount(columns, guesses)
  settle_level(columns, guesses)
  return settle_upside_down(columns, guesses)


def settle_mount(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Take each axis of the car from the axis of the IMU that lies along it, with its sign; a place whose axes are those
  of aircraft, north, east and clockwise, is mirrored. Nothing changes where gravity or speeding up do not show."""
  imu = _imu(columns, guesses)
  mount = imu and _mount(columns, guesses, imu)
  if imu is None or mount is None:
    return
  before = {name: (guess.column, guess.scale) for name, guess in guesses.items()}
  names = (imu.accelerometers[mount.forward], imu.accelerometers[mount.left])
  for channel, column, sign in zip(("accel_x", "accel_y"), names, mount.signs, strict=False):
    _take(guesses, channel, column, sign * imu.scale)
  if "yaw_rate" in guesses and imu.gyros:
    _take(guesses, "yaw_rate", imu.gyros[mount.up], mount.signs[2] * abs(guesses["yaw_rate"].scale))
  told = imu.gyros and "pose_yaw" in guesses  # a heading tells which of gyro and force counts the other way
  if "yaw_rate" in guesses and not told and _correlation(recordings_of(columns, guesses), _going_round) < -ALIKE:
    _take(guesses, "yaw_rate", guesses["yaw_rate"].column, -guesses["yaw_rate"].scale)
    guesses["yaw_rate"].why.append("counted the other way, by what is felt in turns")
  for name in ("accel_x", "accel_y", "yaw_rate"):
    if name in guesses and before.get(name) != (guesses[name].column, guesses[name].scale):
      guesses[name].why.append(_said(mount))
  recordings = recordings_of(columns, guesses)
  if {"pose_x", "pose_y", "pose_yaw"} <= guesses.keys() and contrary(recordings) and goes_with(recordings):
    for name in ("pose_y", "pose_yaw"):
      guesses[name].reverse("counted as in aircraft, to the right: by gravity the gyro turns the other way")


def settle_level(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Exchange the level axes of an IMU where gravity was taken off, or its upright axis was not logged, if by the change
  of speed its y points along the car, and by speed times yaw rate its x across: a telephone's top shows forwards."""
  if not {"accel_x", "accel_y", "yaw_rate"} <= guesses.keys() or lies(columns, guesses):
    return
  x, y = guesses["accel_x"], guesses["accel_y"]
  ahead = {g.column: speeding(columns, guesses, g.column) for g in (x, y)}
  across = {g.column: _rounding(columns, guesses, g.column) for g in (x, y)}
  clear = lambda one, other: abs(one) > max(ALIKE, _CLEARLY * abs(other))
  if not (clear(ahead[y.column], ahead[x.column]) and clear(across[x.column], across[y.column])):
    return
  forward, left = (math.copysign(1.0, alike) for alike in (ahead[y.column], across[x.column]))
  for channel, own, sign in (("accel_x", y, forward), ("accel_y", x, left)):
    turned = {"scale": sign * own.scale, "offset": sign * own.offset, "why": [*own.why]}
    guesses[channel] = dataclasses.replace(own, channel=channel, **turned)
  signed = lambda sign, guess: f"{'-' if sign < 0.0 else ''}'{guess.column}'"
  for channel in ("accel_x", "accel_y"):
    guesses[channel].why.append(
      f"by speeding up {signed(forward, y)} is forwards, and by speed x yaw_rate {signed(left, x)} left"
    )


def settle_upside_down(columns: Columns, guesses: dict[str, Guess]) -> bool:
  """Count an IMU's turning and its force across the other way, where both say the contrary of a heading that goes with
  its path, and the steering, as it was logged, goes with the heading: it lies upside down. Returns whether it does."""
  recordings = recordings_of(columns, guesses)
  if not {"yaw_rate", "accel_y", "pose_yaw", "steering_command"} <= guesses.keys() or not contrary(recordings):
    return False
  by_heading = [r.replace(streams={c: s for c, s in r.streams.items() if c != "yaw_rate"}) for r in recordings]
  agrees = Turning.of(by_heading).alike(_LEAST) > ALIKE
  if not (agrees and goes_with(recordings) and _correlation(recordings, _going_round) > ALIKE):
    return False
  for name in ("yaw_rate", "accel_y"):
    guesses[name].reverse("heading and steering turn the other way, and gyro and accelerometer agree: upside down")
  return True


def settle_left(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Count an accelerometer's left axis the other way where it runs against speed times yaw rate, and the gyro turns as
  a heading that goes with its path: its y points to the right. Without a gyro the heading's own turning counts.

  Nothing changes where no heading confirms the gyro: then either of the two may have the wrong sign. Nor where gravity
  tells how the IMU lies, unless the heading goes with a path to east and north: then its axes are left-handed."""
  if not {"accel_y", "pose_yaw"} <= guesses.keys():
    return
  gyro, known = "yaw_rate" in guesses, {"east", "north"} <= {w for n in _PLACE for w in _words(guesses, n)}
  if (gyro or not known) and lies(columns, guesses):
    return
  recordings = recordings_of(columns, guesses)
  rounds = _going_round if gyro else functools.partial(_going_round, by="pose_yaw")
  if contrary(recordings) or not goes_with(recordings) or not _correlation(recordings, rounds) < -ALIKE:
    return
  guesses["accel_y"].reverse(
    f"it runs against speed x yaw_rate, {'and the heading turns as the gyro' if gyro else 'as the heading turns'}: "
    "right is positive"
  )


def lies(columns: Columns, guesses: dict[str, Guess]) -> bool:
  """Whether the log itself shows how the IMU lies."""
  imu = _imu(columns, guesses)
  return imu is not None and _mount(columns, guesses, imu) is not None


def _said(mount: _Mount) -> str:
  signed = lambda axis, sign: f"{'-' if sign < 0.0 else ''}{_AXES[axis]}"
  way = -1.0 if mount.reversed else 1.0
  forward, left = signed(mount.forward, way * mount.signs[0]), signed(mount.left, way * mount.signs[1])
  what = ", whose accelerometers count against gravity" if mount.reversed else ""
  return f"by gravity and speeding up the IMU's {forward} is forwards and its {left} left{what}"


def _take(guesses: dict[str, Guess], channel: str, column: str, scale: float) -> None:
  guess = guesses.setdefault(channel, Guess(channel, column))
  guess.column, guess.scale = column, scale


def _axis(name: str, kinds: set[str]) -> tuple[int, tuple[str, ...]] | None:
  """The axis that a column's name says for one of these sensors, and the name's other words."""
  words = words_of(name)
  if set(words) & kinds and len(named := [w for w in words if w in _AXES]) == 1:
    return _AXES.index(named[0]), tuple(w for w in words if w not in {named[0], *UNITS})
  for word in words:
    if word[-1] in _AXES and word[:-1] in kinds:
      return _AXES.index(word[-1]), tuple(w for w in words if w not in {word, *UNITS})
  return None


def _triads(columns: Columns, kinds: set[str]) -> dict[tuple[str, ...], dict[int, str]]:
  """By the words that they share, the columns of sensors with three axes."""
  triads: dict[tuple[str, ...], dict[int, str]] = {}
  for name in columns.names:
    if (said := _axis(name, kinds)) is not None:
      triads.setdefault(said[1], {})[said[0]] = name
  return {words: triad for words, triad in triads.items() if len(triad) == 3}


def on_three_axes(columns: Columns) -> set[str]:
  """The columns of accelerometers and gyros of which all three axes were logged: of the sensor's own message, where a
  value that lies alone may be a copy of it."""
  return {
    n for kinds in (_ACCELEROMETERS, _GYROS) for triad in _triads(columns, kinds).values() for n in triad.values()
  }


def _imu(columns: Columns, guesses: Mapping[str, Guess]) -> _Imu | None:
  """The IMU whose accelerometers the guesses take, where all three axes were logged and feel gravity."""
  taken = {guesses[name].column for name in ("accel_x", "accel_y") if name in guesses}
  force = next((t for t in _triads(columns, _ACCELEROMETERS).values() if taken & set(t.values())), None)
  if force is None:
    return None
  names = (force[0], force[1], force[2])
  if (known := _named(names[0])) is not None:
    length = math.hypot(*(known * float(np.median(columns.values(name))) for name in names))
    told = (known, "") if abs(length / GRAVITY - 1.0) < _LIKE_GRAVITY else None
  else:
    told = _by_gravity(columns, names)
  if told is None:
    return None
  gyros = [t for t in _triads(columns, _GYROS).values() if "yaw_rate" in guesses]
  own = next((t for t in gyros if guesses["yaw_rate"].column in t.values()), None)
  return _Imu(names, (own[0], own[1], own[2]) if own else None, told[0])


def _named(name: str) -> float | None:
  """What the unit in an accelerometer's name is in m/s^2; None where it says none."""
  unit = unit_of(name)
  return unit[2] if unit is not None and unit[1] == CHANNELS["accel_x"].unit else None


def _by_gravity(columns: Columns, names: Sequence[str], flat: Collection[str] = ()) -> tuple[float, str] | None:
  """What the accelerometers' unit is in m/s^2, and how that is said; None where no axis is clearly upright, or where it
  reads less than gravity in any known unit: then gravity may have been taken off.

  A usual unit is taken as it is, since a cheap sensor's offset is part of the reading. 1 g lies between what the
  upright axis reads, less by a tilt, and the length, more by a long turn. What is upright reads no more than gravity in
  m/s^2, so that beyond it any unit is told.

  Args:
    flat: columns that the guesses take for level axes; a small reading along one of them may be a long turn's.
  """
  medians = [abs(float(np.median(columns.values(name)))) for name in names]
  length, up = math.hypot(*medians), int(np.argmax(medians))
  if medians[up] < _UPRIGHT * length or (names[up] in flat and length < GRAVITY):
    return None
  between = lambda one: medians[up] / (1.0 + _LIKE_GRAVITY) < one < length / (1.0 - _LIKE_GRAVITY)
  near = next(filter(between, _READS), None)
  if near is None and medians[up] < (1.0 + _LIKE_GRAVITY) * GRAVITY:
    return None
  unit = _READS[near] if near else f"counts of {length:.4g} a g"
  return GRAVITY / (near or length), f"gravity reads {length:.4g}, mostly along '{names[up]}', so in {unit}"


def _mount(columns: Columns, guesses: Mapping[str, Guess], imu: _Imu) -> _Mount | None:
  gravity = np.array([imu.scale * float(np.median(columns.values(name))) for name in imu.accelerometers])
  up = int(np.argmax(np.abs(gravity)))
  if abs(gravity[up]) < _UPRIGHT * GRAVITY:
    return None
  flat = [axis for axis in range(3) if axis != up]
  alike = [speeding(columns, guesses, imu.accelerometers[axis]) for axis in flat]
  best = int(np.argmax(np.abs(alike)))
  if abs(alike[best]) < ALIKE or abs(alike[best]) < _CLEARLY * abs(alike[1 - best]):
    return None
  forward, left = flat[best], flat[1 - best]
  along, upright = math.copysign(1.0, alike[best]), math.copysign(1.0, gravity[up])
  against = along < 0.0 and upright < 0.0  # both: a sign of the sensor, rather than one that lies on its back, reversed
  axes = np.eye(3)
  across = float(upright * along * np.cross(axes[up], axes[forward])[left])
  way = -1.0 if against else 1.0
  return _Mount(forward, left, up, (along, way * across, way * upright), against)


def speeding(columns: Columns, guesses: Mapping[str, Guess], name: str) -> float:
  """Correlation of an accelerometer with the change of the measured speed, in bins; 0 where there are few."""
  trial = {**guesses, "accel_x": Guess("accel_x", name)}
  return _correlation(recordings_of(columns, trial), _speeding_up)


def _rounding(columns: Columns, guesses: dict[str, Guess], name: str) -> float:
  """Correlation of an accelerometer with the measured speed times the yaw rate; 0 where there are few bins."""
  trial = {**guesses, "accel_y": Guess("accel_y", name)}
  return _correlation(recordings_of(columns, trial), _going_round)


def _correlation(recordings: Sequence[Recording], pairs: Callable[[Recording], Array]) -> float:
  felt, driven = np.concatenate([*map(pairs, recordings), np.empty((2, 0))], axis=1)
  return correlation(felt, driven, _LEAST)


def _speeding_up(recording: Recording) -> Array:
  """Mean acceleration ahead and change of speed in bins, (2, k)."""
  name = _finer_speed(recording)
  if not {name, "accel_x"} <= set(recording.channels):
    return np.empty((2, 0))
  edges = _edges(recording)
  return np.stack([_means(recording, "accel_x", edges), np.diff(recording[name].interpolate(edges))])


def _going_round(recording: Recording, by: str = "yaw_rate") -> Array:
  """Mean acceleration to the left, and speed times yaw rate, or times how fast the heading turns, in bins, (2, k)."""
  name = _finer_speed(recording)
  if not {name, "accel_y", by} <= set(recording.channels):
    return np.empty((2, 0))
  edges = _edges(recording)
  speed = recording[name].interpolate(0.5 * (edges[1:] + edges[:-1]))
  turns = _means(recording, by, edges) if by == "yaw_rate" else np.diff(recording[by].interpolate(edges))
  return np.stack([_means(recording, "accel_y", edges), speed * turns])


def _finer_speed(recording: Recording) -> str:
  """The car's speed, or the motor's where that has more samples: of GPS once a second tell no change in a quarter."""
  count = lambda name: len(recording[name]) if name in recording else 0
  return max(("speed", "motor_speed"), key=count)


def _words(guesses: Mapping[str, Guess], channel: str) -> tuple[str, ...]:
  return words_of(guesses[channel].column) if channel in guesses else ()


def _edges(recording: Recording) -> Array:
  return np.arange(recording.start, recording.end, _BIN)


def _means(recording: Recording, channel: str, edges: Array) -> Array:
  """Of the samples in each bin, (k,); NaN where there is none."""
  stream, count = recording[channel], len(edges) - 1
  which = np.searchsorted(edges, stream.time, side="right") - 1
  inside = (which >= 0) & (which < count)
  samples = np.bincount(which[inside], minlength=count)
  return np.where(samples > 0, np.bincount(which[inside], stream.value[inside], count) / np.maximum(samples, 1), np.nan)
