"""Battery that gives way under load."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model, State
from qcar_twin.twin.mechanisms.elements import REFERENCE_VOLTAGE, idle_voltage, ramp

# relative loss at 2.5 of 11 V: three cells of 3.3 Ah have 0.06 ohm (0.074 ohm at 0.85 Ah in the source), those made for
# large currents half of it, beside a motor of 0.15 to 0.5 ohm: the former beside the smallest
_USUAL = 0.02
_AT_ONCE = 0.001  # s
CORNER = 0.005  # of the reference current


class BatterySag(Mechanism):
  """The supply drops under load and recovers afterwards, so the motor gets less than commanded.

  Equation: V = u / (1 + z), tau z' + z = s max(u (u - e), 0)^p / (2.5 V)^2p: battery current is duty times
  motor current, and that goes with u - e, e the back-EMF. With p = 1 and the shortest tau the battery is a resistance
  in the motor's circuit: torque is divided by 1 + s u^2 / (2.5 V)^2, whichever way the current flows.
  Units: s -, relative loss at 2.5 V on a standing motor; p -; tau s; u, e, V V.
  Source: Chen and Rincon-Mora, IEEE Trans. Energy Conversion 21(2), 2006 (electrical battery model).
  Size: stated prior: 0.2 is ten times the loss of a sound battery (`_USUAL`), one that is old, cold or too small.
  Confounded with: quadratic_drag, torque per volt, battery_discharge.
  """

  name = "battery_sag"
  subsystem = "drive"
  stage = "actuator"
  link = "arrival"
  drives = ("voltage", "duty")
  fitted_rank = 14
  parameters = (
    Parameter("battery_sag", 0.0, 0.0, 2.0, "-", "s", null=0.0, typical=0.2, description="relative loss"),
    Parameter("battery_sag_power", 1.0, 0.4, 2.0, "-", "p", description="power of the battery current"),
    Parameter("battery_sag_time", _AT_ONCE, _AT_ONCE, 20.0, "s", "tau", std=0.5, description="recovery time"),
  )

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """Resistance alone, and a battery that recovers over seconds."""
    return ({"battery_sag_time": 0.03}, {"battery_sag_time": 2.0})

  def initial(self, theta: Array, context: Context) -> State:
    return {"drop": np.zeros(len(theta))}

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No battery is without resistance."""
    return {"battery_sag": _USUAL}

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    resistance = np.where(self.passes(theta), theta[:, 0] / REFERENCE_VOLTAGE**2, 0.0)
    model.set("supply_sag", model.get("supply_sag") + resistance)

  def passes(self, theta: Array) -> NDArray[np.bool_]:
    return (theta[:, 1] == 1.0) & (theta[:, 2] <= _AT_ONCE)

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    voltage = command[:, 0]
    current = ramp(voltage * (voltage - idle_voltage(context)) / REFERENCE_VOLTAGE**2, CORNER)
    target = np.where(self.passes(theta), 0.0, theta[:, 0] * current ** theta[:, 1])
    state["drop"] = state["drop"] + (target - state["drop"]) * -np.expm1(-context.period / theta[:, 2])
    acting = command.copy()
    acting[:, 0] = voltage / (1.0 + state["drop"])
    return acting
