"""What every model fits: base parameters, sensors' own errors, tolerances, and by how much a log's clocks disagree.

A likelihood sees a millisecond: gyro and accelerometers that average over a few and a camera's shutter are no physics.
"""

import dataclasses
from collections.abc import Sequence

from calibration.fitting.dataset_recalibration import starting_priors
from qcar_twin.parameters import ParameterSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.twin import Twin

# s: standard deviations of sensors' ages; an IMU's low-pass filter of 100 Hz makes 1.6 ms, a shutter of 1/250 s 2 ms
AGES = {"imu_latency": 0.002, "pose_latency": 0.002}
_WIDEST = 3.0  # standard deviations of these that every model may use up, as of all tolerances


def base_priors(recordings: Sequence[Recording], twin: Twin) -> ParameterSet:
  """Priors of the parameters that every model fits.

  Args:
    recordings: those that are fitted.
    twin: the car with all mechanisms that may be named.
  """
  base = starting_priors(recordings, twin, None)
  ages = [twin.parameters[name] for name in AGES if name in twin.parameters and name not in base]
  return base + [
    dataclasses.replace(
      p, std=AGES[p.name], lower=max(p.lower, -_WIDEST * AGES[p.name]), upper=min(p.upper, _WIDEST * AGES[p.name])
    )
    for p in ages
  ]
