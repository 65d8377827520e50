"""What may have become of a car from which nothing arrives: its driver goes on steering and braking.

Commands that are not heard are not known, either; the last ones may not act any more. Until it is heard again its road
wheels may stand anywhere between their stops and its speed may change as on any floor. Neither changes to and fro, so
that after a time T yaw and speed are uncertain by s T: their variance grows by s^2 (T^2 - (T - h)^2) in a period h.
"""

import numpy as np
from numpy.typing import NDArray

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.models import BETA, STANDSTILL, YAW, R, V
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.estimation.watches.model import LEAST_GRIP

Array = NDArray[np.float64]
STEERED = 0.3  # rad: prior, standard deviation of an angle anywhere between stops at 30 degrees
ANYWHERE = 10.0  # s of it: by 0.2 g a car is a hundred metres on, and nothing is left for more of it to take away
MOST_GRIP = 9.81  # m/s^2: prior, a floor of friction 1 turns a car no faster


def unheard_noise(silent: Array, speed: Array, car: SingleTrackCar, settings: FilterSettings) -> Array | None:
  """Process noise of EKF_BM over a period, (N, n, n), for what is unheard of; None where every car is heard.

  Args:
    silent: s since anything has arrived, (N,). For as long as a sample may be late, `buffer`, the last commands hold;
      after `ANYWHERE` more, yaw and speed get no more uncertain.
    speed: m/s, (N,).
  """
  period, after = settings.period, settings.buffer
  span = np.clip(silent + period - after, 0.0, ANYWHERE)
  if not span.any():
    return None
  grown = span**2 - np.clip(silent - after, 0.0, ANYWHERE) ** 2
  size = np.hypot(speed, STANDSTILL)
  turning = np.minimum(STEERED * size / (car.cg_to_front + car.cg_to_rear), MOST_GRIP / size) ** 2
  noise = np.zeros((len(span), *settings.bicycle_noise.shape))
  noise[:, V, V] = grown * LEAST_GRIP**2
  noise[:, YAW, YAW] = grown * turning
  noise[:, R, R] = (span > 0.0) * turning
  noise[:, BETA, BETA] = noise[:, R, R] * (car.cg_to_rear / size) ** 2
  return noise
