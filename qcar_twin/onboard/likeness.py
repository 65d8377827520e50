"""How far two drives of one script are apart, such as the car's and its twin's: in the end what a twin is for."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

from qcar_twin.onboard.recorder import drive_of
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, RecordingError, nearest

COMPARED = ("motor_speed", "yaw_rate", "accel_y")
_NEIGHBOURS = 5  # poses whose median counts: one that is wrong spoils two gaps where it is interpolated


@dataclasses.dataclass(frozen=True)
class Likeness:
  """Root mean square differences of two drives over the time both cover.

  Attributes:
    seconds: that both cover, s.
    rms: by channel of COMPARED, in its unit, sensors' noise of both included.
    apart: of the two positions at the same time, m, single wrong poses of either left out; NaN where one has none.
  """

  seconds: float
  rms: dict[str, float]
  apart: float

  def __str__(self) -> str:
    said = [f"{name.replace('_', ' ')} {value:.3g} {CHANNELS[name].unit}" for name, value in self.rms.items()]
    place = [f"position {self.apart:.3g} m"] if np.isfinite(self.apart) else []
    return f"differs over {self.seconds:.0f} s by {', '.join([*said, *place])} (root mean square)"


def likeness(ours: Recording, theirs: Sequence[Recording]) -> Likeness:
  """Of one drive and another that may lie in several pieces, on the other's sample times, cut at the shorter one."""
  squares: dict[str, list[np.ndarray]] = {name: [] for name in (*COMPARED, "apart")}
  seconds = 0.0
  for piece in theirs:
    seconds += max(min(piece.end, ours.end) - max(piece.start, ours.start), 0.0)
    for name in COMPARED:
      if name in piece and name in ours:
        squares[name].append((ours[name].interpolate(piece[name].time) - piece[name].value) ** 2)
    if {"pose_x", "pose_y"} <= set(piece.channels) & set(ours.channels):
      gaps = [ours[n].interpolate(piece[n].time) - piece[n].value for n in ("pose_x", "pose_y")]
      x, y = (median_filter(gap, _NEIGHBOURS, mode="nearest") for gap in gaps)
      squares["apart"].append(x**2 + y**2)
  rms = {name: float(np.sqrt(np.nanmean(np.concatenate(parts)))) for name, parts in squares.items() if parts}
  return Likeness(seconds, {name: rms[name] for name in COMPARED if name in rms}, rms.get("apart", float("nan")))


def drives_of_script(folder: Path, script: str) -> dict[str, list[Recording]]:
  """Recordings of every drive of a script in the data set of a folder, by the drive's name.

  Raises:
    RecordingError: the script was not driven there.
  """
  made: dict[str, list[Recording]] = {}
  recordings = DataSet.load(folder).recordings
  for recording in recordings:
    drive = drive_of(recording.name.partition("#")[0])  # a piece of one is named x#2
    if re.fullmatch(rf"{re.escape(script)}(_run\d+)?", drive):
      made.setdefault(drive, []).append(recording)
  if not made:
    drives = sorted({drive_of(r.name) for r in recordings})
    raise RecordingError(f"{folder}: holds no drive of '{script}'{nearest(script, drives)}")
  return made


def compared(ours: Recording, folder: Path, theirs: Mapping[str, Sequence[Recording]]) -> str:
  """A sentence on how far a drive is from each of those in a folder, a line each."""
  return "\n".join(f"{folder}, {name}: this drive {likeness(ours, drive)}" for name, drive in theirs.items())
