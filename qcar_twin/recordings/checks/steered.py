"""Was a car steered by a command that its log does not hold?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.completed import heading_or_course
from qcar_twin.recordings.recording import Recording

_GYRO = 0.2  # rad/s about its median: ten times a gyro's usual zero, and what a car that goes straight on doesn't reach
ACROSS = ("accel_y", "yaw_rate", "pose_x", "pose_y", "pose_yaw", "pose_score")  # what turning shows in
_TURN = 0.5  # rad of the heading, for cars without a gyro: a straight run drifts by less


def without_unsteered(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
  """The recordings without those that turned and hold no steering command while others do, and a note on each.

  A command that is absent is 0, and a car that turns under 0 would bend whatever is fitted to it.
  """
  if not any("steering_command" in r for r in recordings):
    return list(recordings), []
  blind = [r for r in recordings if "steering_command" not in r and _turned(r)]
  notes = [
    f"{r.file or r.name}: the car turned, and steering_command, which other files hold, is absent; it is left out"
    for r in blind
  ]
  return [r for r in recordings if r not in blind], notes


def turns_unsteered(recordings: Sequence[Recording]) -> bool:
  """Whether a car turned and no recording says how it was steered."""
  return not any("steering_command" in r for r in recordings) and any(map(_turned, recordings))


def along_only(recordings: Sequence[Recording]) -> list[Recording]:
  """The recordings without what a car's turning makes its sensors say."""
  kept = lambda r: {name: stream for name, stream in r.streams.items() if name not in ACROSS}
  return [r.replace(streams=kept(r)) for r in recordings]


def _turned(recording: Recording) -> bool:
  if "yaw_rate" in recording:
    rate = recording["yaw_rate"].value
    return float(np.percentile(np.abs(rate - np.median(rate)), 99.0)) > _GYRO
  heading = heading_or_course(recording)
  return heading is not None and float(np.ptp(heading.value)) > _TURN
