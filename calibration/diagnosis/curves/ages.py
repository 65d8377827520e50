"""How old commands and sensors are, all against one clock.

Only differences of ages show: a log whose commands are stamped late looks like one whose sensors speak early. So one
sensor is the clock, the pose where there is one, and everything else is late or early against it. Commands that are
logged rarely are moved earlier by the whole interval between two of them, since a change may have acted up to so long
before the sample that shows it; delays, which cannot be negative, are sought from there.
"""

from collections.abc import Sequence

import numpy as np

from calibration.fitting.noise import noise_models
from calibration.log_check.motions import Wheels, motions
from calibration.log_check.pairs import compare
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

PERIOD = 0.01  # s, of the twin's control
_FINEST = 0.005  # s, and share of a scale: closer than that sensors are not said to agree, wheels slip and bodies roll
_SHOWN_BY = {"turning": ("imu_latency", "gyro_scale"), "driving": ("encoder_latency", None)}


def clock(recordings: Sequence[Recording]) -> str:
  """The age that counts as zero."""
  return "pose_latency" if any("pose_x" in r for r in recordings) else "encoder_latency"


def command_interval(recordings: Sequence[Recording]) -> float:
  """Longest usual time between two logged commands, s."""
  streams = [r[name] for r in recordings for name in (r.drive_channel, "steering_command") if name in r]
  return max(float(np.median(np.diff(s.time))) for s in streams if len(s.time) > 1)


def command_lead(recordings: Sequence[Recording]) -> int:
  """Control periods by which commands are moved earlier; none where they are logged as often as they act."""
  periods = int(round(command_interval(recordings) / PERIOD))
  return periods if periods > 1 else 0


def told_without_a_model(recordings: Sequence[Recording], vehicle: Vehicle) -> dict[str, tuple[float, float]]:
  """Ages [s] and scales [-] of sensors against the pose, with deviations, from geometry alone: parameter -> both.

  See log_check/pairs.py; a deviation counts twice, for what geometry leaves out.
  """
  wheels, noise = Wheels.of(vehicle, recordings), noise_models(recordings)
  told = {}
  for motion in motions(wheels, recordings):
    if motion.name not in _SHOWN_BY or (found := compare(motion, wheels, recordings, noise)).why_not:
      continue
    age, scale = _SHOWN_BY[motion.name]
    told[age] = (found.lag.value, max(2.0 * found.lag.std, _FINEST))
    if scale:
      told[scale] = (found.scale.value - 1.0, max(2.0 * found.scale.std, _FINEST))
  return {name: (value, std) for name, (value, std) in told.items() if np.isfinite(value + std)}
