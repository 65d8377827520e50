"""Slow motor driver."""

from collections.abc import Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import backdrop, lag_step, second_order

_USUAL = 0.015  # s, of a speed controller that means its input over two or three pulses, or limits how fast it rises


class DriveLag(Mechanism):
  """The voltage at the motor follows its command late and rounded off (driver ramp, inductance).

  Equation: q tau^2 V'' + tau V' + V = u.
  Units: tau s, q - (0 first order, 0.25 critically damped). Solved exactly for a held command.
  Source: Franklin, Powell and Workman, Digital Control of Dynamic Systems, 3rd ed., 1998, ch. 4.
  Size: stated prior: 0.1 s, the soft start of a small speed controller; a small motor's inductance alone takes 1 ms
    or less.
  Confounded with: drive_delay, rotor inertia, longitudinal_slip.
  """

  name = "drive_lag"
  subsystem = "drive"
  stage = "command"
  link = "motion"
  open_loop = True
  nonlinear_response = True
  sought_far = True
  fitted_rank = 23
  parameters = (
    Parameter("drive_lag", 0.0, 0.0, 0.6, "s", "tau", null=0.0, typical=0.1, description="low-frequency lag"),
    Parameter("drive_lag_inertia", 0.02, 0.0, 2.0, "-", "q", description="1 / (2 zeta)^2, zeta damping ratio"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Speed controllers smooth what they are told: a usual one is three deviations."""
    return {"drive_lag": _USUAL / 3.0}

  def initial(self, theta: Array, context: Context) -> State:
    state = second_order(theta[:, 0], theta[:, 1], context.period)
    state["output"] = backdrop(context)
    state["rate"] = state["output"] * 0.0
    return state

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    acting[:, 0] = lag_step(state, command[:, 0])
    return acting
