"""Dead time between the commands, both of them, and the car."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model, State
from qcar_twin.twin.mechanisms.elements import (
  delay_step,
  drive_line,
  held_back,
  hold_drive,
  left_of_period,
  told,
  whole_delay_line,
)

_FRAME = 0.02  # s, of a link that carries commands, beside those of pulses that servo and speed controller wait for


class CommandDelay(Mechanism):
  """Both commands act a while after they were logged, or all sensors show it so late: a log tells no difference.

  Equation: V(t) = u_V(t - d); delta(t) = u_delta(t - d).
  Units: d s, V V, delta rad. Parts of a period mix two neighbouring voltages, which is the exact mean; a duty or a
    speed is held for them, and the servo still goes to the angle that it was told before.
  Source: Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., 1997, sec. 2.3.
  Size: stated prior: 0.04 s is two frames of 20 ms, one that a radio waits and one that servo and speed controller do.
  Confounded with: encoder_latency, imu_latency and pose_latency together, the same in a log; drive_delay together with
    steering_delay.
  """

  name = "command_delay"
  subsystem = "command"
  stage = "command"
  link = "arrival"
  open_loop = True
  nonlinear_response = True
  sought_far = True
  imitated_by = ("encoder_latency", "imu_latency", "pose_latency")
  fitted_rank = 28
  parameters = (Parameter("command_delay", 0.0, 0.0, 0.3, "s", "d", null=0.0, typical=0.04, description="dead time"),)

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Few logs say when a command left, whether by a loop's own clock or a network: a frame is three deviations."""
    return {"command_delay": _FRAME / 3.0}

  def initial(self, theta: Array, context: Context) -> State:
    delay, period, longest = theta[:, 0], context.period, self.parameters[0].upper
    voltage, angles = drive_line(delay, longest, context), told(context.before, 1)
    angle = whole_delay_line(delay, period, longest, context.commands[:, 1], context.signal("steering_angle"), angles)
    return _named(voltage, "voltage") | _named(angle, "angle")

  def past(self, theta: Array, before: Array, period: float) -> Array:
    came = (held_back(before[..., k], theta[:, 0], period, whole=bool(k)) for k in range(2))
    return np.stack(list(came), axis=-1)

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    model.set("steering_hold", model.get("steering_hold") + left_of_period(theta[:, 0], context.period))
    hold_drive(model, theta[:, 0], context)

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    for column, which in enumerate(("voltage", "angle")):
      line = {name.removeprefix(f"{which}_"): values for name, values in state.items() if name.startswith(f"{which}_")}
      acting[:, column] = delay_step(line, command[:, column])
      state |= _named(line, which)
    return acting


def _named(line: State, which: str) -> State:
  return {f"{which}_{name}": values for name, values in line.items()}
