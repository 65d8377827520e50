"""Poses that jump: a localisation that is led astray for one sample, which a Gaussian likelihood must not see.

Between neighbouring poses the car moves as wheels and gyro say. A pose that is off makes two errors of opposite sign,
one before and one after it.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.residual_channels import POSE
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

_JUMP = 6.0  # robust standard deviations: once in 10^8 normal samples
_NORMAL = 1.4826  # standard deviation of a normal variable over its median size


def stray_poses(recording: Recording) -> NDArray[np.bool_]:
  """Which samples of the pose channels are jumps, (n,)."""
  if not set(POSE) <= recording.streams.keys():
    return np.zeros(0, dtype=bool)
  time = recording["pose_x"].time
  stray = np.zeros(len(time), dtype=bool)
  if len(time) < 8:
    return stray
  for name in POSE:
    value = recording[name].value if len(recording[name].value) == len(time) else recording[name].at(time, 0.0)
    # from a cubic through two neighbours on either side; ends go with the nearest line
    off = np.zeros(len(value))
    off[2:-2] = value[2:-2] - (-value[:-4] + 4.0 * value[1:-3] + 4.0 * value[3:-1] - value[4:]) / 6.0
    usual = _NORMAL * np.median(np.abs(off[2:-2])) + 1e-9
    large = np.abs(off) > _JUMP * usual
    # a jump shows at its neighbours, too: only the largest of five is one
    peak = np.array([np.abs(off[max(0, k - 2) : k + 3]).max() for k in range(len(off))])
    stray |= large & (np.abs(off) >= peak)
  return stray
