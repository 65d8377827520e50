"""Feed-forward and feedback steering (FF-FB).

delta_FF = L kappa + K_us v^2 kappa, the steady-state steering of the single track; delta_FB = -k (dy + x_la (dpsi +
beta_ss)), a spring on the error projected x_la ahead, with the steady sideslip taken out so that it does not pull the
car off a curve. Sources: Kapania and Gerdes, Design of a feedback-feedforward steering controller for
accurate path tracking and stability at the limits of handling, Vehicle System Dynamics 53(12), 2015;
Chatzikomis et al., IEEE Trans. Intelligent Vehicles 3(4), 2018.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agents.control.interface import Situation
from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.kinematics import sideslip_gain, understeer_gradient

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class FeedforwardFeedback:
  """The controller of N cars.

  Attributes:
    car: the identified model.
    gain: k, rad/m, a number or (N,).
    preview: x_la, m, a number or (N,).
  """

  car: SingleTrackCar
  gain: ArrayLike
  preview: ArrayLike
  name: str = "ff_fb"

  def steer(self, situation: Situation) -> Array:
    """Steering command, rad, (N,)."""
    car, errors, speed = self.car, situation.errors, situation.speed
    wheelbase = np.asarray(car.cg_to_front) + car.cg_to_rear
    stiffness = car.cornering_stiffness_front, car.cornering_stiffness_rear
    gradient = understeer_gradient(car.mass, car.cg_to_front, car.cg_to_rear, *stiffness)
    forward = (wheelbase + gradient * speed**2) * errors.curvature
    slip = sideslip_gain(speed, car.mass, car.cg_to_front, car.cg_to_rear, stiffness[1], gradient) * forward
    ahead = errors.cross_track + np.asarray(self.preview) * (errors.heading + slip)
    return forward - np.asarray(self.gain) * ahead
