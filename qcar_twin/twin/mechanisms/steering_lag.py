"""Slow steering actuator."""

from collections.abc import Mapping, Sequence

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import lag_step, second_order


class SteeringLag(Mechanism):
  """The steering answers its command late and rounded off.

  Equation: q tau^2 delta'' + tau delta' + delta = u, q = 1 / (2 zeta)^2; q = 0 is a first-order lag,
  q = 0.25 critical damping, q = 0.5 a damping ratio of 0.71.
  Units: tau s, q -, delta and u rad. Solved exactly for a held command; the mean over the period acts.
  Source: Franklin, Powell and Workman, Digital Control of Dynamic Systems, 3rd ed., 1998, ch. 4.
  Size: stated prior: 0.05 s is half of the 0.1 s that small servos take for 60 degrees.
  Confounded with: steering_delay (same phase at low frequency), tyre_relaxation (lag that falls with speed).
  """

  name = "steering_lag"
  subsystem = "steering"
  stage = "command"
  link = "motion"
  open_loop = True
  nonlinear_response = True
  sought_far = True
  parameters = (
    Parameter("steering_lag", 0.0, 0.0, 0.4, "s", "tau", null=0.0, typical=0.05, description="low-frequency lag"),
    Parameter("steering_lag_inertia", 0.1, 0.0, 2.0, "-", "q", description="1 / (2 zeta)^2, zeta damping ratio"),
  )

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """Nearly first order, and a servo with a damping ratio of 0.7."""
    return ({"steering_lag_inertia": 0.05}, {"steering_lag_inertia": 0.5})

  def initial(self, theta: Array, context: Context) -> State:
    state = second_order(theta[:, 0], theta[:, 1], context.period)
    state["output"] = context.signal("steering_angle").copy()
    state["rate"] = state["output"] * 0.0
    return state

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    acting[:, 1] = lag_step(state, command[:, 1])
    return acting
