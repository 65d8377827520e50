"""Speed controller whose set-point follows its command at a limited rate."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import backdrop, idle_voltage

_USUAL = 4614.0 / 25000.0  # s^2/m: an F1TENTH's electrical rpm per m/s, over the electrical rpm/s of a VESC's ramp


class SpeedRamp(Mechanism):
  """The speed loop's set-point goes to the commanded speed no faster than a ramp.

  Equation: v_s' = sgn(u - v_s) / q until v_s = u. A stretch that begins under way begins at the command that its motion
    took, between the car's speed and the command.
  Units: q s^2/m, one over the acceleration of the ramp: 0 is none, 0.5 is 2 m/s^2; u and v_s m/s. What acts is the mean
    over a period, which is exact.
  Source: VESC firmware, speed control (s_pid_ramp_erpms_s, 25 000 by default); Franklin, Powell and Workman, Digital
    Control of Dynamic Systems, 3rd ed., 1998, sec. 13.3 (rate limits).
  Size: stated prior: 0.5 s^2/m, 2 m/s^2, a third of the default ramp of an F1TENTH, 5.4 m/s^2.
  Confounded with: drive_lag, speed_loop_integral, encoder_latency.
  """

  name = "speed_ramp"
  subsystem = "drive"
  stage = "command"
  link = "device"
  drives = ("speed",)
  open_loop = True
  nonlinear_response = True
  from_threshold = True
  fitted_rank = 24
  parameters = (
    Parameter(
      "speed_ramp", 0.0, 0.0, 2.0, "s^2/m", "q", null=0.0, typical=0.5, start=_USUAL,
      description="1 / acceleration of the ramp",
    ),
  )  # fmt: skip

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No description states the ramp: a usual controller's is one deviation."""
    return {"speed_ramp": _USUAL}

  def initial(self, theta: Array, context: Context) -> State:
    command, here = context.commands[:, 0], backdrop(context)
    if context.lead is None:
      return {"setpoint": here}
    taken, speed = context.lead[:, 2], idle_voltage(context)
    between = np.clip(taken, np.minimum(speed, command), np.maximum(speed, command))
    return {"setpoint": np.where(np.isfinite(taken), between, here)}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    before, most = state["setpoint"], context.period / np.maximum(theta[:, 0], 1e-15)
    moved = np.clip(command[:, 0] - before, -most, most)
    state["setpoint"] = before + moved
    acting = command.copy()
    acting[:, 0] = before + moved * (1.0 - 0.5 * np.abs(moved) / most)  # it moves for |moved| / most of the period
    return acting
