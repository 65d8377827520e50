"""Sensors that read both ways and were logged as sizes: a gyro or an accelerometer that is never negative, and the
speed of a car that the steering shows driving backwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.checks.driving import LEAST_REST, PERIOD, Drive, runs
from qcar_twin.recordings.recording import Recording

SIGNED = ("accel_x", "accel_y", "yaw_rate")
# A quarter of the noise above 0, and how many samples of it: below 0 a normal density has at least 0.45 times as much
# as there, for any zero that is off by up to five deviations. That 20 are above and none below has a probability of
# exp(-9), 1e-4, at five deviations, and of exp(-16), 1e-7, up to three.
_NEAR, _LEAST = 0.25, 20
_STOPPED = 0.1  # of the top speed, below which a car that was braked may set off backwards
_ALIKE = 0.8  # correlation of turning and steering times speed, from which one shows the other
_LAGS = np.arange(0.0, 0.45, PERIOD)  # s, by which turning follows the command


def sizes_near_zero(recordings: Sequence[Recording], channel: str, noise: float) -> int:
  """How many samples of a sensor lie just above 0, where none at all lies below; 0 where some do, or few say anything.

  Args:
    noise: standard deviation of a sample, in the channel's unit.
  """
  parts = [r[channel].value for r in recordings if channel in r and channel not in r.derived]
  values = np.concatenate(parts) if parts else np.empty(0)
  if not values.size or values.min() < 0.0:
    return 0
  near = int(np.sum((values > 0.0) & (values < _NEAR * noise)))
  return near if near >= _LEAST else 0


def turned_back(drives: Sequence[Drive]) -> list[tuple[Recording, float, float]]:
  """Recording, start and end, s, of stretches under a negative command in which the car, by its steering, drove
  backwards though its speed is positive; none where forward driving does not show how it turns."""
  held = [d for d in drives if {"steering_command", "yaw_rate"} <= set(d.recording.channels)]
  if not held:
    return []
  top = max(float(np.percentile(np.abs(d.speed), 99.0)) for d in held)
  back = [_after_a_stop(d, top) for d in held]
  ahead = [(d.command > 0.0) & (np.abs(d.speed) > _STOPPED * top) for d in held]
  if sum(map(np.count_nonzero, back)) * PERIOD < LEAST_REST:
    return []
  forwards = [_together(held, ahead, lag) for lag in _LAGS]
  best = int(np.argmax(np.abs(forwards)))
  backwards = _together(held, back, float(_LAGS[best])) * np.sign(forwards[best])
  if abs(forwards[best]) < _ALIKE or backwards > -_ALIKE:
    return []
  return [
    (d.recording, float(d.time[first]), float(d.time[last]))
    for d, rows in zip(held, back, strict=True)
    for first, last, there in runs(rows)
    if there
  ]


def _after_a_stop(drive: Drive, top: float) -> np.ndarray:
  """Where the car moves under a negative command once it has stopped under it, (k,)."""
  rows = np.zeros(drive.time.size, dtype=bool)
  slow = np.abs(drive.speed) <= _STOPPED * top
  for first, last, negative in runs(drive.command < 0.0):
    if negative and slow[first : last + 1].any():
      rows[first + int(np.argmax(slow[first : last + 1])) : last + 1] = True
  return rows & ~slow


def _together(held: Sequence[Drive], rows: Sequence[np.ndarray], lag: float) -> float:
  """Correlation, without a mean, of the yaw rate with speed times steering in those rows; 0 where one stays at 0."""
  products, turns = [np.empty(0)], [np.empty(0)]
  for d, there in zip(held, rows, strict=True):
    angle = d.recording["steering_command"].at(d.time - lag)
    turn = d.recording["yaw_rate"].interpolate(d.time)
    known = there & np.isfinite(angle) & np.isfinite(turn)
    products.append((d.speed * angle)[known])
    turns.append(turn[known])
  product, turn = np.concatenate(products), np.concatenate(turns)
  size = float(np.sqrt(np.sum(product**2) * np.sum(turn**2)))
  return float(np.sum(product * turn)) / size if size > 0.0 else 0.0
