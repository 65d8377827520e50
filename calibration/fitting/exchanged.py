"""What a log hardly tells apart: commands that act late, and sensors that all speak late."""

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.optimiser import prior_cost
from qcar_twin.parameters import ParameterSet

Array = NDArray[np.float64]

_COMMANDS = ("drive_delay", "steering_delay")
_SENSORS = ("encoder_latency", "imu_latency", "pose_latency")
_STEP, _MOST = 1e-3, 0.1  # s


def exchanged(parameters: ParameterSet, theta: Array, worth: float) -> Array | None:
  """Estimates in which dead times of all commands have grown by what ages of all sensors have shrunk, or the other way
  round, (p,), so that the priors find them as likely as can be; None where that gains them less than `worth`, nats.

  Both move what sensors show of a drive by the same time. A fit goes from one to the other along a valley, which held
  commands make rough: it may come to rest anywhere on the way.
  """
  change = np.zeros(len(theta))
  for names, sign in ((_COMMANDS, 1.0), (_SENSORS, -1.0)):
    for name in names:
      if name in parameters.names:
        change[parameters.index(name)] = sign
  if not all(name in parameters.names for name in _COMMANDS) or not (change < 0.0).any():
    return None
  tried = theta + np.arange(-_MOST, _MOST + _STEP, _STEP)[:, None] * change
  inside = ((tried >= parameters.lower) & (tried <= parameters.upper) | (change == 0.0)).all(axis=1)
  costs = np.array([prior_cost(one, parameters) for one in tried[inside]])
  if not len(costs) or prior_cost(theta, parameters) - costs.min() < worth:
    return None
  return tried[inside][int(np.argmin(costs))]
