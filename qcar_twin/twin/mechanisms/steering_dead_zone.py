"""Steering that ignores small commands."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import dead_zone


class SteeringDeadZone(Mechanism):
  """Small steering commands about the centre move nothing, and large ones lose as much.

  Equation: delta = sgn(u) max(|u| - b, 0), without memory.
  Units: b rad; corners rounded over 1 mrad.
  Source: Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996, ch. 2.
  Size: stated prior: 0.026 rad, as much as the play of steering_backlash.
  Confounded with: steering_backlash (has memory), steering_gain_error at one amplitude.
  """

  name = "steering_dead_zone"
  subsystem = "steering"
  stage = "command"
  link = "device"
  outlined_by = "steering_curve"
  open_loop = True
  parameters = (
    Parameter("steering_dead_zone", 0.0, 0.0, 0.15, "rad", "b", null=0.0, typical=0.026, description="half-width"),
  )

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    acting[:, 1] = dead_zone(command[:, 1], theta[:, 0])
    return acting
