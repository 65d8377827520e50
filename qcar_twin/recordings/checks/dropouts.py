"""Samples that are no readings: exactly zero between others that are far from it, as a driver or a bus gives where it
has none, and speeds that leap away and are back in the next sample, as of counts over a wrong interval."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from qcar_twin.recordings.channels import CHANNELS

_SPEEDS = ("speed", "motor_speed")
_NEIGHBOURS, _UNUSUAL = 5, 4  # steps on either side of a leap, of which so many may be those of two others
_POSE = ("pose_x", "pose_y", "pose_yaw")
_LONGEST = 3  # samples of one drop-out; a car that stands does so for longer
_FAR = 10.0  # usual steps from zero, which no motion goes there and back within _LONGEST samples


def without_dropouts(
  values: Mapping[str, np.ndarray], zeros: Mapping[str, float], label: str
) -> tuple[dict[str, np.ndarray], list[str]]:
  """Channels with blank cells where a sensor dropped out, and a note for each that did.

  Args:
    values: by channel, (rows,), NaN where a cell is blank.
    zeros: what a zero of the file is in them.
  """
  zero = {channel: zeros.get(channel, 0.0) for channel in values if CHANNELS[channel].kind == "sensor"}
  gone_by = {channel: _dropouts(values[channel], at) for channel, at in zero.items()}  # a command of zero was given
  pose = [channel for channel in _POSE if channel in gone_by]
  if pose:  # of one device: where all are zero, and one of them drops out, all do
    together = np.logical_and.reduce([values[channel] == zero[channel] for channel in pose])
    together &= np.logical_or.reduce([gone_by[channel] for channel in pose])
    gone_by |= {channel: gone_by[channel] | together for channel in pose}
  kept, notes = dict(values), []
  for channel, gone in gone_by.items():
    if gone.any():
      kept[channel] = np.where(gone, np.nan, values[channel])
      notes.append(f"{label}: {channel} drops to 0 and back in {_said(gone)}, which no car does: no reading; left out")
  for channel in kept.keys() & set(_SPEEDS):
    gone = _leaps(kept[channel])
    if gone.any():
      kept[channel] = np.where(gone, np.nan, kept[channel])
      notes.append(
        f"{label}: {channel} leaps away and back in {_said(gone)}, which no car does: counts over a wrong time, or a"
        " message that was read wrongly; left out"
      )
  return kept, notes


def _said(gone: np.ndarray) -> str:
  count = f"{gone.sum()} samples" if gone.sum() > 1 else "a sample"
  return f"{count}, first in row {int(np.argmax(gone)) + 1}"


def _dropouts(value: np.ndarray, zero: float) -> np.ndarray:
  """Rows, (rows,), of a few zeros between two samples that are nearer to each other than to zero, and far from it."""
  gone = np.zeros(value.size, dtype=bool)
  there = np.flatnonzero(~np.isnan(value))
  known = value[there] - zero
  step = np.abs(np.diff(known[known != 0.0]))  # of readings alone, however many zeros are between them
  if not step.any():
    return gone
  usual, rows = np.median(step[step > 0.0]), _between(known)
  longest = max(_LONGEST, rows)
  between = []
  first = np.flatnonzero((known[1:] == 0.0) & (known[:-1] != 0.0)) + 1
  for start in first:
    after = start + int(np.argmax(known[start : start + longest + 1] != 0.0))
    if after == start or after >= known.size:
      continue
    one, two = known[start - 1], known[after]
    near = min(abs(one), abs(two))
    between.append((start, after, near > _FAR * usual and abs(one - two) < 0.5 * near))
  alone = rows > 0 and np.mean([far for _, _, far in between] or [0.0]) > 0.5  # then so it is near zero, too
  for start, after, far in between:
    if far or alone:
      gone[there[start:after]] = True
  return gone


def _leaps(value: np.ndarray) -> np.ndarray:
  """Rows, (rows,), of single samples between two that are nearer to each other than half of the way there, where both
  steps are far beyond all usual ones, near by and everywhere."""
  gone = np.zeros(value.size, dtype=bool)
  there = np.flatnonzero(~np.isnan(value))
  steps = np.diff(value[there])
  if steps.size < 2 * _NEIGHBOURS + 2 or not steps.any():
    return gone
  size = np.abs(steps)
  least = np.minimum(size[:-1], size[1:])
  back = (steps[:-1] * steps[1:] < 0.0) & (np.abs(steps[:-1] + steps[1:]) < 0.5 * least)
  around = np.lib.stride_tricks.sliding_window_view(np.pad(size, _NEIGHBOURS, mode="edge"), 2 * _NEIGHBOURS + 2)
  near_by = np.sort(around, axis=1)[:, -1 - 2 - _UNUSUAL]  # without its own two steps
  usual = np.maximum(near_by, np.median(size[size > 0.0]))
  gone[there[1:-1][back & (least > _FAR * usual)]] = True
  return gone


def _between(known: np.ndarray) -> int:
  """How many zeros are usually between two readings that stand alone, as in a log with a row for each round of a loop
  that is faster than its sensor; 0 where readings follow each other."""
  edges = np.flatnonzero(np.diff((known != 0.0).astype(int), prepend=0, append=0))
  lengths, between = edges[1::2] - edges[::2], edges[2::2] - edges[1:-1:2]
  return int(np.median(between)) if between.size and np.median(lengths) == 1.0 else 0
