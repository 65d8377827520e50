"""A heading against the way the car went: its unit, and whether it counts from north, clockwise.

The course over ground is the direction of the path. With reading q of the heading, m = mean of exp(2i (course - q))
has length 1 where the two go together, whichever way along the heading the car drove, and half its angle is how far the
heading is turned. A heading in another unit gives a length near 0 unless the car hardly turned.
"""

import cmath
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS
from qcar_twin.recordings.checks.time import turn_of
from qcar_twin.recordings.first_dataset.columns import Columns, Guess
from qcar_twin.recordings.recording import Recording, Stream

Array = NDArray[np.float64]
_DEGREE = math.pi / 180.0
_BIN = 0.25  # s of the path that give one course
_MOVING = 0.2  # of the usual way in that time, below which a place has no direction
_LEAST = 20  # courses that say anything
_TOGETHER = 0.9  # length of the mean beyond which heading and course go together: 13 deg of scatter
_BETTER = 0.5  # of what is missing to 1: at most so much is missing to another reading that is better
_SQUARE = 0.3  # rad, within which a heading is a quarter turn off, as a compass's is
_OFF = 0.142  # rad, whose cosine is 0.99: a speed along it is then 1 % off, a sensor's usual tolerance
_STRAIGHT = 0.05  # rad in a bin: points ahead of the axle or behind it go sideways in turns
_LEAPS = 10.0  # times what one bin in ten turns by: a marker that was mistaken for another, and no car
_CONTRARY = -0.85  # correlation of a gyro that turns the other way


def courses(recordings: Sequence[Recording]) -> tuple[Array, Array, Array]:
  """Course [rad], the logged heading [its unit] and which way the car was driven, 1 or -1 by its speed, else by the
  drive's command, 0 where neither tells; in bins in which the car moved, (k,) each."""
  parts = [np.empty((3, 0))]
  for recording in recordings:
    if not {"pose_x", "pose_y", "pose_yaw"} <= set(recording.channels):
      continue
    yaw, half, middles = recording["pose_yaw"], 0.5 * _BIN, np.arange(recording.start, recording.end, _BIN) + 0.5 * _BIN
    if len(yaw) > 1 and (apart := float(np.median(np.diff(yaw.time)))) > _BIN:  # as of GPS: about each of its samples
      half, middles = 0.5 * apart, yaw.time
    nearest = np.clip(np.searchsorted(yaw.time, middles), 0, len(yaw) - 1)
    x, y = (p.interpolate(middles + half) - p.interpolate(middles - half)
            for p in (recording["pose_x"], recording["pose_y"]))  # fmt: skip
    way = np.hypot(x, y)
    far = way > _MOVING * np.nanpercentile(way, 90.0) if np.isfinite(way).any() else np.zeros(len(way), dtype=bool)
    parts.append(np.stack([np.arctan2(y, x), yaw.value[nearest], _driven(recording, middles)])[:, far])
  course, heading, way = np.concatenate(parts, axis=1)
  return course, heading, way


def _driven(recording: Recording, middles: Array) -> Array:
  """1 where the car is driven forwards, -1 backwards, 0 unknown, at times, s."""
  names = ("speed", "motor_speed", *DRIVE_COMMANDS)
  name = next((n for n in names if n in recording and n not in recording.derived), None)
  if name is None:
    return np.zeros(middles.size)
  value = recording[name].at(middles) if CHANNELS[name].is_command else recording[name].interpolate(middles)
  return np.where(np.isfinite(value), np.sign(value), 0.0)


def goes_with(recordings: Sequence[Recording]) -> bool:
  """Whether the heading, as it is read, goes with the path."""
  return abs(_mean(*courses(recordings)[:2])) > _TOGETHER


def settle_heading(guess: Guess, recordings: Sequence[Recording], geographic: bool = False) -> None:
  """The reading of a heading that goes with the path much better than the present one; a compass's only where a gyro,
  too, turns the other way, since a place of exchanged axes looks the same, or where the place is east and north, or the
  heading's own name says so (`geographic`)."""
  course, heading, way = courses(recordings)
  opposed = contrary(recordings)
  if len(course) < _LEAST:
    if geographic and opposed:
      guess.scale, guess.offset = -guess.scale, 0.5 * math.pi - guess.offset
      guess.why.append("clockwise from north by its name, as the gyro turns")
    return
  signs = (1.0, -1.0) if geographic and not opposed else (-1.0 if opposed else 1.0,)
  now, units = abs(_mean(course, heading)), (1.0,) if guess.named else (1.0, _DEGREE)
  means = {sign * unit: _mean(course, sign * unit * heading) for unit in units for sign in signs}
  factor = max(means, key=lambda f: abs(means[f]))
  if abs(means[factor]) < _TOGETHER or 1.0 - abs(means[factor]) > _BETTER * (1.0 - now):
    _turn(guess, course, heading, way)
    return
  turned = 0.5 * cmath.phase(means[factor])
  if factor < 0.0 and abs(abs(turned) - 0.5 * math.pi) > _SQUARE:
    return  # the place is mirrored, or a sign is wrong: the check tells
  guess.scale, guess.offset = factor * guess.scale, factor * guess.offset
  said = (
    f"the car went along it in {'degrees' if abs(factor) != 1.0 else 'rad'} ({abs(means[factor]):.2f}, else {now:.2f})"
  )
  if factor < 0.0:
    guess.offset += 0.5 * math.pi
    said += ", clockwise from north, as " + ("the gyro turns" if opposed else "the path goes")
  guess.why.append(said)


def settle_gyro(guesses: Mapping[str, Guess], recordings: Sequence[Recording]) -> None:
  """Count a gyro that turns contrary to a heading the other way, with the force across that goes with it, where the
  heading goes with a path whose left and right are known: it has the axes of aircraft, z down."""
  if "yaw_rate" not in guesses or not contrary(recordings) or not goes_with(recordings):
    return
  for name in ("yaw_rate", "accel_y"):
    if name in guesses:
      guesses[name].reverse("counted to the right, as in aircraft: the heading turns the other way along its path")


def unwrap_heading(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """Unwrap a heading that jumps by a whole turn, once; one that jumps by 360 is in degrees. No log is read before."""
  heading = guesses.get("pose_yaw")
  if heading is None or heading.wrap:
    return
  values = np.concatenate(
    [heading.scale * t.number(heading.column, "pose_yaw") for t in columns.holding(heading.column)]
  )
  period = turn_of(values[np.isfinite(values)])
  if period:
    heading.wrap = True
    heading.why.append(f"it jumps by turns of {period:.4g}")
  if period in (180.0, 360.0):
    heading.scale *= math.pi / 180.0


def _turn(guess: Guess, course: Array, heading: Array, way: Array) -> None:
  """Turn a heading, rad, that goes with the path at an angle to it, as a compass' or a marker's that was put on askew.
  By the path alone a quarter of a turn has no side, and half a turn none at all: a quarter's is that on which the car
  goes forwards while it is driven forwards, and half a turn is left."""
  straight = np.abs(np.angle(np.exp(1j * np.diff(heading, prepend=heading[0] + np.pi)))) < _STRAIGHT
  mean = _mean(course[straight], heading[straight])
  by = 0.5 * cmath.phase(mean)
  if abs(mean) < _TOGETHER or abs(by) < _OFF:
    return
  if abs(by) > 0.5 * math.pi - _SQUARE:
    told = straight & (way != 0.0)
    side = np.sum(way[told] * np.cos(course[told] - heading[told] - by))
    if abs(side) < _TOGETHER * np.count_nonzero(told) or np.count_nonzero(told) < _LEAST:
      return
    by += math.pi * (side < 0.0)
  by = math.remainder(by, math.tau)
  guess.offset += by
  guess.why.append(f"turned by {by:.2f} rad: the car goes straight on at that angle to it")


def _mean(course: Array, heading: Array) -> complex:
  return complex(np.mean(np.exp(2.0j * (course - heading)))) if len(course) >= _LEAST else 0.0j


def contrary(recordings: Sequence[Recording]) -> bool:
  """Whether the gyro turns the other way than the heading."""
  parts = [np.empty((2, 0))]
  for recording in recordings:
    if not {"yaw_rate", "pose_yaw"} <= set(recording.channels):
      continue
    edges = np.arange(recording.start, recording.end, _BIN)
    heading = recording["pose_yaw"]
    if period := turn_of(heading.value):
      heading = Stream(heading.time, np.unwrap(heading.value, period=period))
    turned = np.diff(heading.interpolate(edges))
    parts.append(np.stack([turned, recording["yaw_rate"].interpolate(edges[:-1] + 0.5 * _BIN)]))
  turned, rate = np.concatenate(parts, axis=1)
  known = np.isfinite(turned) & np.isfinite(rate)
  if known.sum() < _LEAST or not turned[known].any() or not rate[known].any():
    return False
  known &= np.abs(turned) < _LEAPS * np.percentile(np.abs(turned[known]), 90.0)  # though the car went straight for long
  return bool(known.sum() >= _LEAST and np.corrcoef(turned[known], rate[known])[0, 1] < _CONTRARY)


__all__ = ["contrary", "courses", "goes_with", "settle_gyro", "settle_heading", "unwrap_heading"]
