"""Poses that jump: a map that was relocalised, a body that was relabelled, a simulator that was reset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.recording import Recording, Stream

_NEIGHBOURS = 5  # steps on either side that say how far the car moves between two poses
_BEYOND = 10.0  # times as fast as any neighbour: no car gains that speed within one sample
_FLICKER = 3  # samples after which a pose that went away is back: wrong samples, and no new place


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
  wrong = _flickers(place, _jumps(x.time, place, least), least)
  notes = []
  if wrong.any():
    first = x.time[int(np.argmax(wrong))]
    notes.append(
      f"{recording.file or recording.name}: the pose jumps away and back, first at {first:g} s, {int(wrong.sum())} "
      "samples; they are left out"
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


def _flickers(place: np.ndarray, jumps: np.ndarray, least: float) -> np.ndarray:
  """Samples between a jump and one back, (k,)."""
  wrong = np.zeros(len(place), dtype=bool)
  at = np.flatnonzero(jumps)
  for go, back in zip(at[:-1], at[1:], strict=True):
    away, home = abs(place[go + 1] - place[go]), abs(place[back + 1] - place[go])
    if back - go <= _FLICKER and home < max(0.2 * away, least):
      wrong[go + 1 : back + 1] = True
  return wrong


def _kept(recording: Recording, time: np.ndarray, good: np.ndarray) -> Recording:
  streams = dict(recording.streams)
  for name in ("pose_x", "pose_y", "pose_yaw"):
    if name in streams and np.array_equal(streams[name].time, time):
      streams[name] = Stream(time[good], streams[name].value[good])
  return recording.replace(streams=streams)
