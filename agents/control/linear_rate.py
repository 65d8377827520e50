"""The linear rate policy: the paper's agent without the network.

d(delta)/dt = -k . [dy, d(dy)/dt, dpsi, d(dpsi)/dt], bounded, integrated and held at the lock. Because the
action is a rate, the policy integrates: a steering gain or offset it does not know leaves no steady error.
It sees and does what the reinforcement-learning agent sees and does, so it is the floor such an agent must reach.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from agents.control.interface import Situation
from qcar_twin.vehicle.vehicle import QCAR

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class LinearRate:
  """The policy of N cars.

  Attributes:
    gain: k, (4,) or (N, 4): rad/s per m, per m/s, per rad, per rad/s.
    largest: bound of the steering rate, rad/s.
    lock: bound of the steering angle it integrates, rad.
  """

  gain: Array
  largest: float = 1.5
  lock: float = QCAR.max_steering
  name: str = "linear_rate"

  def answer(self, errors: Array) -> Array:
    """Steering rate, rad/s, (N,), to the four errors, (N, 4)."""
    return np.clip(-np.sum(self.gain * errors, axis=-1), -self.largest, self.largest)

  def steer(self, situation: Situation) -> Array:
    """Steering command, rad, (N,)."""
    steering = situation.steering + self.answer(situation.errors.observation) * situation.period
    return np.clip(steering, -self.lock, self.lock)
