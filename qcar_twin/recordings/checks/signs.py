"""Sensors that read both ways and were logged as sizes: a gyro or an accelerometer that is never negative."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.recording import Recording

SIGNED = ("accel_x", "accel_y", "yaw_rate")
# A quarter of the noise above 0, and how many samples of it: below 0 a normal density has at least 0.45 times as much
# as there, for any zero that is off by up to five deviations. That 20 are above and none below has a probability of
# exp(-9), 1e-4, at five deviations, and of exp(-16), 1e-7, up to three.
_NEAR, _LEAST = 0.25, 20


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
