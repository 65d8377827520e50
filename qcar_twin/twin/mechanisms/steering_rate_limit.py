"""Steering servo with a top speed."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State
from qcar_twin.vehicle.similarity import Similarity


class SteeringRateLimit(Mechanism):
  """The steering moves no faster than the servo can turn.

  Equation: |delta'| <= 1 / q; the angle runs at that rate until it meets the command u.
  Units: q s/rad (0.2 is a limit of 5 rad/s, 0 is no limit), delta and u rad. The mean over the period acts:
  u - (u - delta) m(r) with r = |u - delta| q / T, m = r / 2 up to r = 1, then 1 - 1 / (2 r).
  Source: Franklin, Powell and Workman, Digital Control of Dynamic Systems, 3rd ed., 1998, sec. 13.3 (saturation).
  Confounded with: steering_lag; it grows with the size of a step where a lag does not.
  """

  name = "steering_rate_limit"
  subsystem = "steering"
  stage = "command"
  open_loop = True
  fitted_rank = 10
  parameters = (
    Parameter(
      "steering_inverse_rate", 0.0, 0.0, 1.0, "s/rad", "q", null=0.0, typical=0.2, description="1 / highest rate"
    ),
  )

  def initial(self, theta: Array, context: Context) -> State:
    return {"angle": context.signal("steering_angle").copy()}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    error = command[:, 1] - state["angle"]
    time = np.abs(error) * theta[:, 0] / context.period  # periods until the command is met
    late = np.maximum(time, 1.0)
    acting[:, 1] -= error * np.where(time < 1.0, 0.5 * time, 1.0 - 0.5 / late)
    state["angle"] = command[:, 1] - error * (1.0 - 1.0 / late)
    return acting

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No servo is without a limit: data sheets of small ones state 60 degrees in 0.1 s, here three deviations.

    A large car's are slower by its similarity.
    """
    return {"steering_inverse_rate": 0.1 / 3.0 * Similarity.of(car.wheelbase).time}
