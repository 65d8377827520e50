"""Dead time between voltage command and motor."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model, State
from qcar_twin.twin.mechanisms.elements import delay_step, drive_line, held_back, hold_drive

_FRAME = 0.02  # s, in which pulses for speed controllers come: a command waits for the next


class DriveDelay(Mechanism):
  """The motor gets the voltage that was commanded a while ago.

  Equation: V(t) = u(t - d).
  Units: d s. Parts of a period mix two neighbouring voltages, which is the exact mean; a duty or speed is held.
  Source: Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., 1997, sec. 2.3.
  Size: stated prior: 0.035 s is a frame of 20 ms, in which pulses for speed controllers come, and one and a half
    control periods of 10 ms.
  Confounded with: drive_lag, imu_latency.
  """

  name = "drive_delay"
  subsystem = "drive"
  stage = "command"
  link = "arrival"
  open_loop = True
  nonlinear_response = True
  sought_far = True
  fitted_rank = 22
  parameters = (Parameter("drive_delay", 0.0, 0.0, 0.2, "s", "d", null=0.0, typical=0.035, description="dead time"),)

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Whether a speed controller is told by pulses few descriptions say: a frame is three deviations."""
    return {"drive_delay": _FRAME / 3.0}

  def initial(self, theta: Array, context: Context) -> State:
    return drive_line(theta[:, 0], self.parameters[0].upper, context)

  def past(self, theta: Array, before: Array, period: float) -> Array:
    return np.stack([held_back(before[..., 0], theta[:, 0], period), before[..., 1]], axis=-1)

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    hold_drive(model, theta[:, 0], context)

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    acting[:, 0] = delay_step(state, command[:, 0])
    return acting
