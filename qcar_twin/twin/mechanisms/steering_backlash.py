"""Play in the steering linkage."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import STANDSTILL

# rad, three deviations: gears of a servo and ball links that are not worn have half a degree; its dead band of up to
# 8 us of the 400 to one side (Hitec HS-422, data sheet) is half a degree of the road wheels more
_USUAL = 0.0175


class SteeringBacklash(Mechanism):
  """The wheels follow only once the play in the linkage is taken up.

  Equation: delta stays where it is while |u - delta| < b / 2, else it is dragged along:
  delta+ = min(max(delta, u - b / 2), u + b / 2). A car that begins in mid-drive has its wheels where it turns to,
  r L / v_x, as far as the play lets them: on which side they lie commands before would tell, and the turning does.
  Units: b rad, the whole play at the wheels.
  Source: Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996, ch. 2.
  Size: stated prior: 0.026 rad is 1.5 deg, 0.5 mm of play on an arm of 19 mm.
  Confounded with: steering_dead_zone (no memory), steering_quantisation.
  """

  name = "steering_backlash"
  subsystem = "steering"
  stage = "command"
  link = "play"
  open_loop = True
  fitted_rank = 18
  parameters = (
    Parameter("steering_play", 0.0, 0.0, 0.15, "rad", "b", null=0.0, typical=0.026, description="whole play"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """No linkage is without play: a usual one is three deviations."""
    return {"steering_play": _USUAL / 3.0}

  def initial(self, theta: Array, context: Context) -> State:
    command, half = context.signal("steering_angle"), 0.5 * theta[:, 0]
    speed = context.signal("velocity_x")
    # at a crawl the turning says nothing, and the wheels are taken to be at the command
    turned = context.signal("yaw_rate") * context.car.wheelbase * speed / (speed**2 + STANDSTILL**2)
    told = speed**2 / (speed**2 + STANDSTILL**2)
    return {"angle": command + np.clip(turned - told * command, -half, half)}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    half = 0.5 * theta[:, 0]
    state["angle"] = np.minimum(np.maximum(state["angle"], command[:, 1] - half), command[:, 1] + half)
    acting[:, 1] = state["angle"]
    return acting
