"""Times and places counted from nearby: what is taken off a stamp of the day or a map's coordinates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.recording import Recording, Stream

FAR = 1e4  # m, from a map's origin; the floor and the course of a data set are smaller


def near(recordings: Sequence[Recording]) -> list[Recording]:
  """The same recordings with all places counted from the first one's first, whole metres, where that is far away."""
  first = next((r for r in recordings if {"pose_x", "pose_y"} <= set(r.channels)), None)
  if first is None:
    return list(recordings)
  at = tuple(float(np.round(first[name].value[0])) for name in ("pose_x", "pose_y"))
  if max(abs(place) for place in at) < FAR:
    return list(recordings)
  return [_moved(r, at) for r in recordings]


def _moved(recording: Recording, at: tuple[float, ...]) -> Recording:
  streams = dict(recording.streams)
  for name, place in zip(("pose_x", "pose_y"), at, strict=True):
    if name in streams:
      streams[name] = Stream(streams[name].time, streams[name].value - place)
  return recording.replace(streams=streams, origin=(recording.origin[0], *at))
