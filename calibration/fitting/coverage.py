"""Whether the fitted recordings go everywhere the judging ones go, and what to do where they don't.

An error of the steering to the right can't be learnt from turns to the left. A recording that only judges and
goes where no fitted one goes can veto a name and can't find one: that half of it which goes there more is fitted, too,
and the other half goes on judging, as the hold-out runs do.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.windows import DEFAULT_CUT
from qcar_twin.kinematics import road_speed
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.checks.time import MIN_SAMPLES
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_OUTSIDE = 0.1  # share of the judging drives that may lie outside
_EDGE = 1.0  # per cent of the fitted driving that is left out at either end of its range
_WIDER = 0.1  # of the range, by which it is widened: so far a fit is trusted beyond what it saw
_DRIVEN = 0.1  # of the largest drive command, below which the car is taken to stand or to coast
_PERIOD = 0.01  # s
_WHOLE = 2.0 * DEFAULT_CUT.length  # s: of a shorter recording a half would not fill a stretch, so it stays whole


def with_coverage(dataset: DataSet) -> tuple[DataSet, tuple[str, ...]]:
  """Give what goes far outside what is fitted the role "identify", farthest first, until little is left outside.

  It is what the car was commanded while it was driven, drive and steering, sign and all, and how fast it went round:
  friction that no fitted drive came near is not learnt from commands that were all there one by one. Recordings
  are halved, again where half is too much or too little; short ones change their role whole. Nothing is changed where
  no hold-out recording would be left to judge.

  Args:
    dataset: recordings with roles.

  Returns:
    the data set with the roles to be used, and a sentence per recording, or part of one, whose role was changed, and
    per hold-out recording that goes outside all the same.
  """
  recordings, notes = list(dataset.recordings), []
  if not dataset.role("holdout") or not dataset.role("identify"):
    return dataset, ()
  least = _DRIVEN * max(float(np.abs(c[:, 0]).max(initial=0.0)) for c in map(_commands, recordings))
  car = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  while True:
    driven = [_driven(r, least, car) for r in recordings]
    ranges = _ranges([d for r, d in zip(recordings, driven, strict=True) if r.role == "identify"])
    judging = [i for i, r in enumerate(recordings) if r.role == "validate" and len(driven[i])]
    outside = {i: int(_beyond(driven[i], ranges).any(axis=1).sum()) for i in judging}
    if ranges is None or sum(outside.values()) <= _OUTSIDE * sum(len(driven[i]) for i in judging):
      break
    i = max(judging, key=outside.__getitem__)
    pieces = _halves(recordings[i])
    beyond = [_beyond(_driven(p, least, car), ranges) for p in pieces]
    taken = max(range(len(pieces)), key=lambda k: int(beyond[k].any(axis=1).sum()))
    notes.append(_sentence(pieces[taken], beyond[taken], ranges))
    pieces[taken] = pieces[taken].replace(role="identify")
    recordings[i : i + 1] = pieces
  for recording, drive in zip(recordings, driven, strict=True):
    if recording.role == "holdout" and len(drive) and (away := _beyond(drive, ranges)).any(axis=1).mean() > _OUTSIDE:
      notes.append(_opened(recording, away, ranges))
  return dataclasses.replace(dataset, recordings=tuple(recordings)), tuple(notes)


def _halves(recording: Recording) -> list[Recording]:
  """A recording cut in the middle; as it is where it is short, or one half would hardly tell how fast the car was."""
  middle = 0.5 * (recording.start + recording.end)
  speeds = [recording[name].time for name in ("motor_speed", "speed") if name in recording]
  shown = max((min(np.sum(t < middle), np.sum(t >= middle)) for t in speeds), default=0)
  if recording.duration < _WHOLE or shown < MIN_SAMPLES:
    return [recording]
  spans = (recording.start, float(np.nextafter(middle, -np.inf))), (middle, recording.end)
  first, second = (recording.window(*s).replace(name=f"{recording.name}#{k}") for k, s in enumerate(spans, 1))
  return [first, second.replace(before=None)]  # what was driven before it is counted again, the first half with it


def _commands(recording: Recording) -> Array:
  return recording.commands(_PERIOD)[1]


def _driven(recording: Recording, least: float, car: Vehicle) -> Array:
  """Commands while that of the drive exceeds `least`, in its unit, either way, and v r, m/s^2, (k, 3)."""
  time, commands = recording.commands(_PERIOD)
  driven = np.column_stack([commands, _going_round(recording, time, car)])
  return driven[np.abs(commands[:, 0]) > least]


def _going_round(recording: Recording, time: Array, car: Vehicle) -> Array:
  """Speed times yaw rate as both were measured, m/s^2, (T,); 0 where either was not."""
  speed = next((recording[name] for name in ("motor_speed", "speed") if name in recording), None)
  if speed is None or "yaw_rate" not in recording:
    return np.zeros(len(time))
  along = road_speed(speed.interpolate(time), car) if "motor_speed" in recording else speed.interpolate(time)
  return np.nan_to_num(along * recording["yaw_rate"].interpolate(time))


def _ranges(driven: Sequence[Array]) -> Array | None:
  """Lower and upper end of each, (2, 3); None where nothing was driven."""
  together = np.concatenate(driven)
  if not len(together):
    return None
  low, high = np.percentile(together, [_EDGE, 100.0 - _EDGE], axis=0)
  room = _WIDER * (high - low)
  return np.stack([low - room, high + room])


def _beyond(driven: Array, ranges: Array | None) -> NDArray[np.bool_]:
  """Which samples lie outside, in each of what is driven, (k, 3)."""
  return np.zeros(driven.shape, bool) if ranges is None else (driven < ranges[0]) | (driven > ranges[1])


def _sentence(piece: Recording, beyond: NDArray[np.bool_], ranges: Array) -> str:
  return (
    f"{piece.name} ({piece.start:.1f} s to {piece.end:.1f} s) was fitted although its role is validate:"
    f" {_outside(piece, beyond, ranges)}, and no"
    " recording with the role identify goes there. The rest and the hold-out recordings judge what came of it."
  )


def _opened(recording: Recording, beyond: NDArray[np.bool_], ranges: Array | None) -> str:
  assert ranges is not None  # nothing lies outside of no range
  return (
    f"{recording.name} is a hold-out recording and goes where nothing that is fitted goes:"
    f" {_outside(recording, beyond, ranges)}. Its errors there say how the twin goes on beyond what it learnt."
  )


def _outside(recording: Recording, beyond: NDArray[np.bool_], ranges: Array) -> str:
  """What of a recording lies outside most, as part of a sentence."""
  k = int(np.argmax(beyond.sum(axis=0)))
  what = (recording.drive_channel, "steering_command", "the lateral acceleration")[k]
  unit = "m/s^2" if k == 2 else CHANNELS[what].unit
  between = f"{ranges[0, k]:.3g} to {ranges[1, k]:.3g} {unit}".removesuffix(" -")
  return f"{100.0 * float(np.mean(beyond[:, k])):.0f} % of its driving has {what} outside {between}"
