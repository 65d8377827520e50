"""Play in the gears."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import idle_voltage


class DrivelineBacklash(Mechanism):
  """When the torque changes sign the motor first runs through the play, then hits with what it gained.

  Equation: J g'' = k (u - e) while |g| < b / 2, g the motor's angle in the play; meanwhile no torque reaches the
  wheels, at the stop the momentum J g' does. In time steps: the share (t_c / T)^2 of the torque, t_c the time
  to the stop, is carried over to the next period, which gives the right delay of the momentum.
  Units: b rad at the motor, J kg m^2 of the motor alone, u and e (back-EMF) V.
  Source: Nordin and Gutman, Automatica 38(10), 2002.
  Size: stated prior: 1 rad at the motor is 5.5 deg at the QCar's wheels (gear ratio 0.095), two meshes of gears and
    the joints of the shafts.
  Confounded with: drive_delay, which is there without a change of sign.
  """

  name = "driveline_backlash"
  subsystem = "drive"
  stage = "actuator"
  link = "play"
  drives = ("voltage", "duty")
  parameters = (
    Parameter("driveline_play", 0.0, 0.0, 5.0, "rad", "b", null=0.0, typical=1.0, description="play at the motor"),
    Parameter("driveline_play_inertia", 2e-6, 1e-7, 5e-5, "kg m^2", "J", std=2e-6, description="motor's own inertia"),
  )

  def initial(self, theta: Array, context: Context) -> State:
    driving = np.tanh((context.commands[:, 0] - idle_voltage(context)) / 0.05)
    zero = np.zeros(len(theta))
    return {"place": driving, "speed": zero, "carried": zero.copy()}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    """State: `place` in the play, -1 to 1; `speed` across it, rad/s; `carried` momentum as V of one period."""
    idle, period = idle_voltage(context), context.period
    net = command[:, 0] - idle
    push = net * context.torque_per_volt / theta[:, 1]  # rad/s^2
    side = np.where(push < 0.0, -1.0, 1.0)
    half = 0.5 * theta[:, 0]
    left = half * (1.0 - side * state["place"])  # rad to the stop
    ahead, strength = state["speed"] * side, np.abs(push)
    to_stop = 2.0 * left / np.maximum(ahead + np.sqrt(ahead * ahead + 2.0 * strength * left), 1e-9)
    free = np.minimum(to_stop / period, 1.0)
    acting = command.copy()
    total = net + state["carried"]
    acting[:, 0] = idle + total * (1.0 - free * free)
    state["carried"] = total * free * free
    travel = side * (ahead + 0.5 * strength * period) * period
    flying = free >= 1.0
    place = np.clip(state["place"] + travel / np.maximum(half, 1e-9), -1.0, 1.0)
    state["place"] = np.where(flying, place, side)
    state["speed"] = np.where(flying, state["speed"] + push * period, 0.0)
    return acting
