"""Motor that gets weaker as it gets hot."""

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, State
from qcar_twin.twin.mechanisms.by_motion import Weakening
from qcar_twin.twin.mechanisms.elements import USUAL_VOLTAGE

_USUAL = 0.03  # loss of a winding that is 8 K warmer, as after some minutes of gentle driving


class MotorHeating(Weakening):
  """A hot motor has more resistance, so its torque fades, and weaker magnets, so it also idles faster; both recover.

  Equation: torque = k exp(-(g + m) T) (u - e exp(-m T)), tau T' = (u / 1 V)^2 - T; before the segment the mean of
    u^2 acted.
  Units: g, m -, relative loss of conductance and of the motor constant once warm at 1 V; T - (1 is that warmth);
    tau s; e is the back-EMF of the cold motor, V.
  Source: Krishnan, Electric Motor Drives, 2001, ch. 2; Hughes and Drury, Electric Motors and Drives, 4th ed., 2013.
  Size: 0.15: copper loses 15 % of its conductance when 45 K warmer, at 0.39 % of resistance per K, and ferrite 15 %
    of its flux when 75 K warmer, at 0.2 % per K; stated prior: that a motor gets so warm at 1 V.
  Confounded with: battery_discharge, which does not recover in a pause.
  """

  name = "motor_heating"
  subsystem = "drive"
  stage = "actuator"
  link = "motion"
  drives = ("voltage", "duty")
  fitted_rank = 19
  parameters = (
    Parameter("motor_heating", 0.0, 0.0, 1.0, "-", "g", null=0.0, typical=0.15, description="loss when warm"),
    Parameter("motor_heating_magnets", 0.0, 0.0, 1.0, "-", "m", null=0.0, typical=0.15, description="magnets' part"),
    Parameter("motor_heating_time", 60.0, 5.0, 600.0, "s", "tau", description="thermal time constant"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No winding stays cold: what gentle driving warms is three deviations."""
    return {"motor_heating": _USUAL / 3.0}

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """A small motor and a large one."""
    return ({"motor_heating_time": 20.0}, {"motor_heating_time": 120.0})

  def initial(self, theta: Array, context: Context) -> State:
    seconds, energy = context.history.T
    power = energy / np.maximum(seconds, 1e-6) / USUAL_VOLTAGE**2
    return {"warmth": power * -np.expm1(-seconds / theta[:, 2])}

  def weakened(self, theta: Array, commands: Array, period: float, state: State) -> Array:
    warmth, nearer = np.empty(commands.shape), -np.expm1(-period / theta[:, 2])
    for now, power in zip(warmth, (commands / USUAL_VOLTAGE) ** 2, strict=True):
      now[:] = state["warmth"]
      state["warmth"] = state["warmth"] + (power - state["warmth"]) * nearer
    return np.exp(-theta[:, 1::-1] * warmth[:, :, None])
