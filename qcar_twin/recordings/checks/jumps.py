"""Poses that jump: a map that was relocalised, a body that was relabelled, a simulator that was reset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.recording import Recording, Stream

_NEIGHBOURS = 5  # steps on either side that say how far the car moves between two poses
_BEYOND = 10.0  # times as fast as any neighbour: no car gains that speed within one sample
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
