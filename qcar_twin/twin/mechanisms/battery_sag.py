"""Battery that gives way under load."""

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import REFERENCE_VOLTAGE, idle_voltage, ramp

CORNER = 0.005  # of the reference current


class BatterySag(Mechanism):
  """The supply drops under load and recovers afterwards, so the motor gets less than commanded.

  Equation: V = u / (1 + z), tau z' + z = s max(u (u - e), 0)^p / (2.5 V)^2p: battery current is duty times
  motor current, and that goes with u - e, e the back-EMF.
  Units: s -, relative loss at 2.5 V on a standing motor; p -; tau s; u, e, V V.
  Source: Chen and Rincon-Mora, IEEE Trans. Energy Conversion 21(2), 2006 (electrical battery model).
  Confounded with: quadratic_drag, torque per volt, battery_discharge.
  """

  name = "battery_sag"
  subsystem = "drive"
  stage = "actuator"
  drives = ("voltage", "duty")
  parameters = (
    Parameter("battery_sag", 0.0, 0.0, 2.0, "-", "s", null=0.0, typical=0.2, description="relative loss"),
    Parameter("battery_sag_power", 1.0, 0.4, 2.0, "-", "p", description="power of the battery current"),
    Parameter("battery_sag_time", 0.03, 0.001, 20.0, "s", "tau", std=0.5, description="recovery time"),
  )

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """Resistance alone, and a battery that recovers over seconds."""
    return ({"battery_sag_time": 0.03}, {"battery_sag_time": 2.0})

  def initial(self, theta: Array, context: Context) -> State:
    return {"drop": np.zeros(len(theta))}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    voltage = command[:, 0]
    current = ramp(voltage * (voltage - idle_voltage(context)) / REFERENCE_VOLTAGE**2, CORNER)
    target = theta[:, 0] * current ** theta[:, 1]
    state["drop"] = state["drop"] + (target - state["drop"]) * -np.expm1(-context.period / theta[:, 2])
    acting = command.copy()
    acting[:, 0] = voltage / (1.0 + state["drop"])
    return acting
