"""Does the battery's voltage that duties are shares of belong to the car that is described, and did it last?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.checks.driving import runs
from qcar_twin.recordings.recording import Recording, Stream

_FULL = 95.0  # per cent of a log's readings below what its battery had at best
_SPAN = 4.2 / 3.0  # V of a lithium cell, charged and at its cut-off: no battery reads further from its usual
_AT_ONCE = 1.0  # s: a resistance takes none, a slow reading as much; charge does not come back


def supply_notes(recordings: Sequence[Recording], vehicle: Mapping[str, float | str]) -> list[str]:
  """What to know before a result is trusted: a supply that isn't the battery's, and files in which it stands for it."""
  driven = [r for r in recordings if r.drive_channel == "motor_duty" and "motor_duty" in r]
  without = [r for r in driven if r.battery is None]
  usual = float(np.median(np.concatenate([r.battery.value for r in driven if r.battery is not None] or [[np.nan]])))
  notes = []
  stated = float(vehicle.get("supply_voltage", np.nan))
  if max(usual / stated, stated / usual) > _SPAN:
    notes.append(
      f"battery_voltage is {usual:.3g} V (median), which is no {stated:.3g} V battery's, full or empty; duties act on "
      "what was logged; correct supply_voltage in [vehicle], or scale battery_voltage in [channels]"
    )
  if len(without) < len(driven):
    notes += [f"{r.file or r.name}: has no battery_voltage; supply_voltage stands for it" for r in without]
  return notes + _empty_notes(recordings)


def _empty_notes(recordings: Sequence[Recording]) -> list[str]:
  """Files in which the battery read, more than once in a row, less than one that was full has at its cut-off."""
  read = [(r, r.battery) for r in recordings]
  best = [float(np.percentile(stream.value, _FULL)) for _, stream in read if stream is not None]
  notes = []
  for recording, stream in read:
    if stream is None:
      continue
    low = [(a, b) for a, b, empty in runs(stream.value < max(best) / _SPAN) if empty and b > a]
    if low:
      (first, last), more = low[0], f", and {len(low) - 1} times more" if len(low) > 1 else ""
      why = "empty, or a loose plug; leave out what was driven so with to in its [[recording]]"
      if _sags(recording, stream, low):
        why = "under load, and it recovers at once: a pack of high internal resistance, or a nearly empty one; "
        why += "if it was a loose plug, leave out what was driven so"
      notes.append(
        f"{recording.file or recording.name}: battery_voltage falls to {stream.value.min():.3g} V from"
        f" {stream.time[first]:.2f} s to {stream.time[last]:.2f} s{more}, where it has {max(best):.3g} V at best:"
        f" {why}, or correct battery_voltage in [channels]"
      )
  return notes


def _sags(recording: Recording, stream: Stream, low: Sequence[tuple[int, int]]) -> bool:
  """Whether each fall is under more than is usually asked of the drive, and half undone within a second of its end."""
  name = recording.drive_channel
  if name not in recording or not len(recording[name]):
    return False
  load, best = np.abs(recording[name].at(stream.time)), float(np.percentile(stream.value, _FULL))
  usual, halfway = float(np.median(load)), 0.5 * (best + float(stream.value.min()))
  back = [stream.value[b:][stream.time[b:] <= stream.time[b] + _AT_ONCE].max() > halfway for _, b in low]
  return all(back) and all(float(load[a : b + 1].mean()) > usual for a, b in low)
