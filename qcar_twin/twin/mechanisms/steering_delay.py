"""Dead time between steering command and actuator."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model, State
from qcar_twin.twin.mechanisms.elements import delay_step, held_back, left_of_period, told, whole_delay_line

_FRAME = 0.02  # s, in which pulses for servos come: a command waits for the next


class SteeringDelay(Mechanism):
  """The steering executes what was commanded a while ago.

  Equation: delta(t) = u(t - d).
  Units: d s, delta and u rad. In a part of a period the servo still goes to the angle that it was told before.
  Source: Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., 1997, sec. 2.3.
  Size: stated prior: 0.04 s is two frames of 20 ms, in which pulses for servos come.
  Confounded with: steering_lag, imu_latency with pose_latency.
  """

  name = "steering_delay"
  subsystem = "steering"
  stage = "command"
  link = "arrival"
  open_loop = True
  nonlinear_response = True
  sought_far = True
  fitted_rank = 20
  parameters = (Parameter("steering_delay", 0.0, 0.0, 0.2, "s", "d", null=0.0, typical=0.04, description="dead time"),)

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Whether a servo is told by pulses few descriptions say: a frame is three deviations."""
    return {"steering_delay": _FRAME / 3.0}

  def initial(self, theta: Array, context: Context) -> State:
    delay, longest, past = theta[:, 0], self.parameters[0].upper, told(context.before, 1)
    present, before = context.commands[:, 1], context.signal("steering_angle")
    return whole_delay_line(delay, context.period, longest, present, before, past)

  def past(self, theta: Array, before: Array, period: float) -> Array:
    return np.stack([before[..., 0], held_back(before[..., 1], theta[:, 0], period, whole=True)], axis=-1)

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    model.set("steering_hold", model.get("steering_hold") + left_of_period(theta[:, 0], context.period))

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    acting[:, 1] = delay_step(state, command[:, 1])
    return acting
