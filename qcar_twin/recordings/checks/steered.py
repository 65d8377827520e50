"""Was a car steered by a command that its log does not hold?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.checks.units import Bins, speed_in
from qcar_twin.recordings.completed import heading_or_course
from qcar_twin.recordings.recording import Recording, RecordingError

_GYRO = 0.2  # rad/s about its median: ten times a gyro's usual zero, and what a car that goes straight on doesn't reach
ACROSS = ("accel_y", "yaw_rate", "pose_x", "pose_y", "pose_yaw", "pose_score")  # what turning shows in
_TURN = 0.5  # rad of the heading, for cars without a gyro: a straight run drifts by less
_LEAST = 20  # bins that tell
_MOVES = 0.3  # of the top speed, from which a path's curvature is known
# a command that moves by less than a tenth of what the path takes, and does not go with it, steered nothing; one in
# another unit goes with it
_STILL, _ALIKE = 0.1, 0.5
_STEERED = 0.15  # rad between the angles that a path takes, stated prior: from lock to lock a car has 0.7 and more
_LAGS = np.arange(0.0, 0.45, 0.05)  # s, of the turning behind the command


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


def without_dead_steering(
  recordings: Sequence[Recording], vehicle: Mapping[str, float | str]
) -> tuple[list[Recording], list[str]]:
  """The recordings, without a steering command that stays where it is while the car turns as no such angle lets it, and
  a note on each: a sensor of the steering that is not connected, a command that went elsewhere. A command that never
  changes at all is one: 0, say, of a car that was to go straight on.

  Args:
    vehicle: numbers of the car, of which the wheelbase counts, and what travel a turn of its motor is.

  Raises:
    RecordingError: no recording holds another.
  """
  kept, notes = [], []
  for recording in recordings:
    if (stays := _dead_at(recording, vehicle)) is None:
      kept.append(recording)
      continue
    streams = {name: stream for name, stream in recording.streams.items() if name != "steering_command"}
    kept.append(recording.replace(streams=streams))
    notes.append(
      f"{recording.file or recording.name}: steering_command stays at {stays:.2g} rad while the car turns as that "
      "angle does not let it: a sensor that is not connected, or a command that went elsewhere"
    )
  if notes and not any("steering_command" in recording for recording in kept):
    cure = "map the command that steered the car, or take steering_command out of [channels] to judge the drive alone"
    raise RecordingError(f"{notes[0]}; {cure}")
  return kept, [f"{note}; it is left out" for note in notes]


def _dead_at(recording: Recording, vehicle: Mapping[str, float | str]) -> float | None:
  """The angle, rad, at which a steering command stays that did not steer the car; None where it did, or where the
  car's wheelbase, or what travel a turn of its motor is, is not known and needed."""
  if not {"steering_command", "yaw_rate"} <= set(recording.channels) or not {"cg_to_front", "cg_to_rear"} <= set(
    vehicle
  ):
    return None
  wheelbase, bins = float(vehicle["cg_to_front"]) + float(vehicle["cg_to_rear"]), Bins(recording)
  (speed, _), rate = speed_in(bins, vehicle), bins.mean("yaw_rate")
  known = np.isfinite(speed) & np.isfinite(rate)
  known &= np.abs(speed) > _MOVES * np.max(np.abs(speed[known]), initial=0.0)
  if known.sum() < _LEAST:
    return None
  turns = np.arctan(wheelbase * rate[known] / speed[known])
  commanded = [recording["steering_command"].at(bins.middles[known] - lag) for lag in _LAGS]
  spread = lambda values: float(np.subtract(*np.percentile(values, [95.0, 5.0])))
  path = spread(turns)
  if path < max(abs(float(np.median(turns))), _STEERED):
    return None  # it went straight on, as far as trim and floor let it, or round one circle
  if not 0.0 < spread(commanded[0]) < _STILL * path or max(_correlated(angle, turns) for angle in commanded) > _ALIKE:
    return None
  return float(np.median(commanded[0]))


def _correlated(a: np.ndarray, b: np.ndarray) -> float:
  """Size of the correlation; 0 of what is constant."""
  return abs(float(np.corrcoef(a, b)[0, 1])) if np.ptp(a) > 0.0 and np.ptp(b) > 0.0 else 0.0


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
