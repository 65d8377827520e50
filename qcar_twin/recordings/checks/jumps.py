"""What changes all at once: poses that jump, as of a map that was relocalised, a body that was relabelled or a
simulator that was reset; a unit that changes in mid-file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.checks.units import EXACT, Bins, suspects_of
from qcar_twin.recordings.recording import Recording, RecordingError, Stream

_NEIGHBOURS = 5  # steps on either side that say how far the car moves between two poses
_BEYOND = 10.0  # times as fast as any neighbour: no car gains that speed within one sample
_SIDE = 20  # bins before and after a change that tell it
_PLACES = 32  # in a recording, at which a change is looked for first
_MOVES = 0.2  # of what a sensor reaches, from which the ratio of two is known
_STEADY = 0.15  # of its logarithm, median deviation on either side: sensors of one motion whose ratio stays
_FLICKER = 3  # samples within which a pose that went away is back: wrong samples, and no new place


@dataclass(frozen=True)
class Jump:
  """From the last pose before it to the first one after, s, and how far, m."""

  before: float
  after: float
  distance: float


def without_jumps(recording: Recording, least: float) -> tuple[Recording, list[Jump], list[str]]:
  """The recording without single poses that jump away and back, where the pose jumps for good, and notes.

  Args:
    least: m, a jump that matters; the car's own length.
  """
  if not {"pose_x", "pose_y"} <= set(recording.channels):
    return recording, [], []
  x, y = recording["pose_x"], recording["pose_y"]
  if len(x) != len(y) or not np.array_equal(x.time, y.time) or len(x) < 2 * _NEIGHBOURS:
    return recording, [], []
  place = x.value + 1j * y.value
  wrong = _flickers(place, _jumps(x.time, place, least))
  notes = []
  if wrong.any():
    first = x.time[int(np.argmax(wrong))]
    notes.append(
      f"{recording.file or recording.name}: the pose jumps away and back, first at {first:g} s; wrong samples: "
      f"{int(wrong.sum())}, left out"
    )
    recording = _kept(recording, x.time, ~wrong)
    place, time = place[~wrong], x.time[~wrong]
  else:
    time = x.time
  at = np.flatnonzero(_jumps(time, place, least))
  return recording, [Jump(float(time[k]), float(time[k + 1]), float(abs(place[k + 1] - place[k]))) for k in at], notes


def _jumps(time: np.ndarray, place: np.ndarray, least: float) -> np.ndarray:
  """Of each step between two poses, whether it is far faster than its neighbours, (k - 1,).

  A pose that was frozen while tracking was lost catches up in one step, which has the time since it last changed.
  """
  step = np.abs(np.diff(place))
  changed = np.r_[0, np.flatnonzero(step > 0.0) + 1]
  since = time[changed[np.searchsorted(changed, np.arange(len(step)), side="right") - 1]]
  speed = step / (time[1:] - since)
  padded = np.pad(speed, _NEIGHBOURS, mode="edge")
  windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1)
  others = np.delete(windows, _NEIGHBOURS, axis=1)
  usual = np.sort(others, axis=1)[:, -3]  # two of them may be jumps, too
  return (speed > _BEYOND * usual) & (step > least)


def _flickers(place: np.ndarray, jumps: np.ndarray) -> np.ndarray:
  """Wrong samples before or after a jump, (k,): those away from the way that the pose takes on either side of them.

  Within _FLICKER samples a car moves less than half a jump. So a pose that is nearer to the jump's other end by then
  has come back, and the jump there or the jump back alone tells which samples are wrong.
  """
  wrong = np.zeros(len(place), dtype=bool)
  for last in np.flatnonzero(jumps):
    first, low = last + 1, max(0, last - _FLICKER)
    half = 0.5 * abs(place[first] - place[last])
    back = np.flatnonzero(np.abs(place[first + 1 : first + 1 + _FLICKER] - place[last]) < half)
    from_there = np.flatnonzero(np.abs(place[low:last] - place[first]) < half)
    if len(back):
      wrong[first : first + 1 + back[0]] = True
    if len(from_there):
      wrong[low + 1 + from_there[-1] : first] = True
  return wrong


def _kept(recording: Recording, time: np.ndarray, good: np.ndarray) -> Recording:
  streams = dict(recording.streams)
  for name in ("pose_x", "pose_y", "pose_yaw"):
    if name in streams and np.array_equal(streams[name].time, time):
      streams[name] = Stream(time[good], streams[name].value[good])
  return recording.replace(streams=streams)


def refuse_changed_units(recording: Recording) -> None:
  """Raises RecordingError where two sensors of one motion stand in one ratio until some time and in another after it,
  by the factor of a usual unit of either."""
  bins = Bins(recording)
  for a, b, first, other in _of_one_motion(bins):
    change = _change(bins.edges, first, other)
    if change is None:
      continue
    at, before, after = change
    factor = after / before
    named = [
      suspect
      for name in (a, b)
      for suspect in suspects_of(name)
      if min(abs(math.log(factor * s)) for s in (suspect.scale, 1.0 / suspect.scale)) < math.log(EXACT)
    ]
    if named:
      units = " or ".join(dict.fromkeys(f"of {suspect.channel}, {suspect.unit}" for suspect in named))
      raise RecordingError(
        f"{recording.file or recording.name}: {a} is {before:.3g} times {b} until {at:.4g} s and {after:.3g} times "
        f"after it, a factor of {max(factor, 1.0 / factor):.3g}: a unit changes in mid-file ({units}); write "
        f"to = {at:.4g} in its [[recording]], or correct the column"
      )


def _of_one_motion(bins: Bins) -> list[tuple[str, str, np.ndarray, np.ndarray]]:
  """Names and values in bins of pairs that measure one motion, the first as measured."""
  has, pairs = set(bins.recording.channels), []
  if {"speed", "motor_speed"} <= has:
    pairs.append(("speed", "motor_speed", bins.mean("speed"), bins.mean("motor_speed")))
  if {"pose_x", "pose_y"} <= has:
    path, measured = np.hypot(bins.change("pose_x"), bins.change("pose_y")), has - set(bins.recording.derived)
    pairs += [(name, "pose_x", bins.mean(name), path) for name in ("speed", "motor_speed") if name in measured]
  if {"yaw_rate", "pose_yaw"} <= has:
    pairs.append(("yaw_rate", "pose_yaw", bins.mean("yaw_rate"), bins.change("pose_yaw")))
  return pairs


def _change(edges: np.ndarray, first: np.ndarray, other: np.ndarray) -> tuple[float, float, float] | None:
  """When the ratio of two sensors changes most, s, and its medians before and after; None where it stays, or scatters
  about either.

  Args:
    edges: of the bins that the sensors are given in, s.
  """
  known = np.isfinite(first) & np.isfinite(other) & (first * other != 0.0)
  if known.sum() < 2 * _SIDE:
    return None
  reach = float(np.percentile(np.abs(other[known]), 95.0))
  where = np.flatnonzero(known & (np.abs(other) > _MOVES * reach))
  if where.size < 2 * _SIDE:
    return None
  ratio = np.log(np.abs(first[where] / other[where]))
  tried = np.linspace(_SIDE, where.size - _SIDE, _PLACES).astype(int)
  sides = [(float(np.median(ratio[:k])), float(np.median(ratio[k:]))) for k in tried]
  before, after = max(sides, key=lambda side: abs(side[1] - side[0]))
  nearer = np.where(np.abs(ratio - before) < np.abs(ratio - after), 1, -1)
  k = int(np.clip(np.argmax(np.cumsum(nearer)) + 1, _SIDE, where.size - _SIDE))
  scatter = max(float(np.median(np.abs(part - middle))) for part, middle in ((ratio[:k], before), (ratio[k:], after)))
  if abs(after - before) < math.log(EXACT) or scatter > _STEADY:
    return None
  return float(edges[where[k]]), math.exp(before), math.exp(after)
