"""How old what sensors show is, all against one clock.

Only differences of ages show: a log whose commands are stamped late looks like one whose sensors speak early. So one
sensor is the clock, the pose where there is one, and everything else is late or early against it.
"""

from collections.abc import Sequence

import numpy as np

from calibration.fitting.noise import noise_models
from calibration.log_check.motions import Wheels, motions
from calibration.log_check.pairs import compare
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

_FINEST = 0.005  # s, and share of a scale: closer than that sensors are not said to agree, wheels slip and bodies roll
_SHOWN_BY = {"turning": ("imu_latency", "gyro_scale"), "driving": ("encoder_latency", None)}


def clock(recordings: Sequence[Recording]) -> str:
  """The age that counts as zero."""
  return "pose_latency" if any("pose_x" in r for r in recordings) else "encoder_latency"


def fitted_ages(dataset: DataSet, vehicle: Vehicle) -> dict[str, tuple[float, float]]:
  """What `told_without_a_model` says of the recordings that are fitted or judge a fit."""
  return told_without_a_model([r for r in dataset.recordings if r.role != "holdout"], vehicle)


def told_without_a_model(recordings: Sequence[Recording], vehicle: Vehicle) -> dict[str, tuple[float, float]]:
  """Ages [s] and scales [-] of sensors against the pose, with deviations, from geometry alone: parameter -> both.

  See log_check/pairs.py; a deviation counts twice, for what geometry leaves out. Nothing without a pose.
  """
  if clock(recordings) != "pose_latency":
    return {}
  wheels, noise = Wheels.of(vehicle, recordings), noise_models(recordings)
  told = {}
  for motion in motions(wheels, recordings):
    if motion.name not in _SHOWN_BY or (seen := compare(motion, wheels, recordings, noise)).why_not:
      continue
    age, scale = _SHOWN_BY[motion.name]
    told[age] = (seen.lag.value, max(2.0 * seen.lag.std, _FINEST))
    if scale:
      told[scale] = (seen.scale.value - 1.0, max(2.0 * seen.scale.std, _FINEST))
  return {name: (value, std) for name, (value, std) in told.items() if np.isfinite(value + std)}
