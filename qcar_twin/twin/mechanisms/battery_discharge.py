"""Battery that runs down."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import USUAL_VOLTAGE

SPAN = 300.0  # s: length of a session, over which the loss is stated
_TENTH = 0.03  # of its voltage, stated prior: what a full lithium cell loses with the first tenth of its charge


class BatteryDischarge(Mechanism):
  """The battery runs down from recording to recording, and the same command gives less voltage.

  Equation: V = u exp(-d z), z = ((1 - h) t + h E / (1 V)^2) / 300 s, t seconds driven, E the integral of u^2.
  Units: d -, relative loss after 300 s (at 1 V); h -, share that goes with the energy spent; E V^2 s.
  Source: Chen and Rincon-Mora, IEEE Trans. Energy Conversion 21(2), 2006 (open-circuit voltage against charge).
  Size: 0.1: a lithium-ion cell falls from 4.2 V to about 3.7 V, by 12 %, over most of its charge (Chen and
    Rincon-Mora, 2006); stated prior: that a session of 300 s takes nearly as much.
  Confounded with: motor_heating, torque per volt.
  """

  name = "battery_discharge"
  subsystem = "drive"
  stage = "actuator"
  link = "arrival"
  open_loop = True
  drives = ("voltage", "duty")
  fitted_rank = 34
  parameters = (
    Parameter("battery_discharge", 0.0, 0.0, 1.0, "-", "d", null=0.0, typical=0.1, description="loss after 300 s"),
    Parameter("battery_discharge_energy", 0.5, 0.0, 1.0, "-", "h", description="share that goes with energy"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No battery stays full: a session that takes a tenth of its charge is three deviations."""
    return {"battery_discharge": _TENTH / 3.0}

  def initial(self, theta: Array, context: Context) -> State:
    return {"energy": context.history[:, 1].copy()}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    time = context.history[:, 0] + context.time
    share = theta[:, 1]
    used = ((1.0 - share) * time + share * state["energy"] / USUAL_VOLTAGE**2) / SPAN
    acting = command.copy()
    acting[:, 0] = command[:, 0] * np.exp(-theta[:, 0] * used)
    state["energy"] = state["energy"] + context.commands[:, 0] ** 2 * context.period
    return acting
