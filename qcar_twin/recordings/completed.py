"""Channels that no sensor logged but that others give: speed from a motion capture's pose, a command from the speed,
the course from a place without a heading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.recording import Recording, RecordingError, Stream

UNJUDGED = "cannot be judged"  # what a note about a derived channel says, and every fit has to say again
_WINDOW = 0.1  # s of poses for one speed: as long as the fastest answers of a drive
_LEAST = 5  # poses in a window; a parabola has three numbers
_TELLS = 10.0  # times its noise, from which a velocity's direction is told: 0.1 rad
_RAGGED = 2.0  # times the usual interval between poses, from which a window is no window


def completed(
  pieces: Sequence[Recording], vehicle: Mapping[str, float | str], label: str
) -> tuple[list[Recording], list[str]]:
  """The pieces with a speed, from the pose where no sensor gave it, and a command of the drive; notes, each once."""
  out, notes = [], []
  for piece in pieces:
    with_it, said = with_speed(piece)
    whole, by_hand = _driven_by_hand(with_it, vehicle, label)
    if not {"speed", "motor_speed"} & set(whole.channels):
      span = f"from {piece.start:.2f} s to {piece.end:.2f} s"
      raise RecordingError(
        f"{label}: {span} the pose has too few samples to give a speed; leave out the [[recording]] of those seconds, "
        "make it longer, or log a speed"
      )
    out.append(whole)
    notes += [*said[: not notes], *by_hand]
  return out, list(dict.fromkeys(notes))


def _driven_by_hand(
  recording: Recording, vehicle: Mapping[str, float | str], label: str
) -> tuple[Recording, list[str]]:
  """The measured speed as the drive's command where none was logged, and a note that the drive cannot be judged."""
  if set(DRIVE_COMMANDS) & set(recording.channels):
    return recording, []
  speed = recording.streams.get("speed")
  if speed is None:
    travel = float(vehicle.get("gear_ratio", np.nan)) * float(vehicle.get("wheel_radius", np.nan))
    if not np.isfinite(travel):
      raise RecordingError(
        f"{label}: no column is mapped to a command of the drive, and the speed is only the motor's; give gear_ratio "
        "and wheel_radius in [vehicle], or map speed in [channels]"
      )
    speed = Stream(recording["motor_speed"].time, travel * recording["motor_speed"].value)
  note = (
    f"{label}: no column is mapped to a command of the drive; the measured speed stands for it, so turning can be "
    'judged, and the drive cannot be judged; write drive = "speed" in [vehicle]'
  )
  derived = (*recording.derived, "speed_command")
  return recording.replace(streams={**recording.streams, "speed_command": speed}, derived=derived), [note]


def with_speed(recording: Recording) -> tuple[Recording, list[str]]:
  """The recording with `speed` from its pose where no sensor of speed was logged, and a note with the noise of it.

  A parabola is fitted to the way driven in every 0.1 s, five poses at least, added up along the heading where one was
  logged; speed is its slope in the middle, and its size alone where there is no heading. Windows share no pose but the
  one between them, so that the noise of two speeds is hardly correlated. With n poses every h seconds and noise s its
  deviation is s / h sqrt(12 / (n (n^2 - 1))).
  """
  has = set(recording.channels)
  if has & {"speed", "motor_speed"} or not {"pose_x", "pose_y"} <= has:
    return recording, []
  signed = "pose_yaw" in recording
  middle, slopes, error, span = _velocities(recording, signed)
  if len(middle) < 2:
    return recording, []
  speed = slopes[0] if signed else np.hypot(*slopes)
  how = "along the heading" if signed else "its size, as there is no heading to tell backwards"
  note = (
    f"{recording.file or recording.name}: no sensor of speed was logged; it is the slope of the"
    f" pose over {1e3 * span:.0f} ms, {how}, with a noise of {error:.2g} m/s; so slip of the wheels"
    f" and a scale of the pose {UNJUDGED}"
  )
  streams = {**recording.streams, "speed": Stream(middle, speed)}
  return recording.replace(streams=streams, derived=(*recording.derived, "speed")), [note]


def speed_window(speed: Stream) -> float:
  """Time over which `with_speed` takes the pose for one speed, s: each begins where the one before ends."""
  return float(np.median(np.diff(speed.time))) if len(speed) > 1 else _WINDOW


def ways(recording: Recording) -> list[Stream]:
  """What the pose says of how far the car has gone, m: along its heading, backwards less; or x and y without one."""
  time = recording["pose_x"].time
  if "pose_yaw" not in recording:
    return [recording["pose_x"], recording["pose_y"]]
  (way,) = _along(recording, time)
  known = np.isfinite(way)
  return [Stream(time[known], way[known])]


def heading_or_course(recording: Recording) -> Stream | None:
  """What turns as the car does, rad: its heading, or the direction of its path where only a place was logged.

  The direction is that of the velocities of `with_speed` where they are ten times their noise. It is unwrapped by half
  turns, so that it goes on where the car backs up. It differs from the heading by the sideslip, and by half a turn.
  None where neither can be had.
  """
  if "pose_yaw" in recording:
    return recording["pose_yaw"]
  if not {"pose_x", "pose_y"} <= set(recording.channels):
    return None
  middle, slopes, error, _ = _velocities(recording, signed=False)
  told = np.hypot(*slopes) > _TELLS * error
  if told.sum() < 2:
    return None
  return Stream(middle[told], np.unwrap(np.arctan2(slopes[1], slopes[0])[told], period=np.pi))


def _velocities(recording: Recording, signed: bool) -> tuple[np.ndarray, np.ndarray, float, float]:
  """Times (k,) s, slopes of the way along the heading (1, k) or of x and y (2, k), their noise, m/s, and window, s."""
  x, y = recording["pose_x"], recording["pose_y"]
  time, none = x.time, (np.zeros(0), np.zeros((1 if signed else 2, 0)), 0.0, 0.0)
  step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
  count = max(_LEAST, round(_WINDOW / step) + 1) if step > 0.0 else _LEAST
  first = np.arange(0, len(time) - count + 1, count - 1)
  rows = first[:, None] + np.arange(count)
  if not first.size:
    return none
  whole = np.diff(time[rows], axis=1).max(axis=1) < _RAGGED * step
  rows = rows[whole]
  if not len(rows):
    return none
  place = _along(recording, time) if signed else np.stack([x.value, y.interpolate(time)])
  rows = rows[np.isfinite(place[:, rows]).all(axis=(0, 2))]
  if len(rows) < 2:
    return none
  middle = time[rows].mean(axis=1)
  slopes, noise = _slopes(time[rows] - middle[:, None], place[:, rows])
  return middle, slopes, noise / step * float(np.sqrt(12.0 / (count * (count**2 - 1.0)))), step * (count - 1)


def _slopes(time: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, float]:
  """Slopes (d, k) at the middles of windows of parabolas through places (d, k, n), times (k, n), and the noise, m."""
  design = np.stack([np.ones_like(time), time, time**2], axis=-1)
  turned = np.swapaxes(design, 1, 2)
  numbers = np.linalg.solve(turned @ design, turned @ np.moveaxis(place, 0, -1))
  residual = np.moveaxis(place, 0, -1) - design @ numbers
  free = time.shape[1] - 3
  median = free * (1.0 - 2.0 / (9.0 * free)) ** 3  # of chi^2, by Wilson and Hilferty
  return numbers[:, 1].T, float(np.sqrt(np.median(np.sum(residual**2, axis=1)) / median))


def _along(recording: Recording, time: np.ndarray) -> np.ndarray:
  """Way driven at the times of pose_x, m, (1, k): steps along the heading halfway between two poses, NaN where none
  is known."""
  x, y = recording["pose_x"].value, recording["pose_y"].interpolate(time)
  yaw = recording["pose_yaw"].interpolate(0.5 * (time[1:] + time[:-1]))
  steps = np.cos(yaw) * np.diff(x) + np.sin(yaw) * np.diff(y)
  way = np.r_[0.0, np.cumsum(np.nan_to_num(steps))]
  return np.where(np.r_[True, np.isfinite(steps)], way, np.nan)[None]
