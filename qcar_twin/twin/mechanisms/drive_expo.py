"""Throttle curve of a radio or a speed controller."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State


class DriveExpo(Mechanism):
  """Small duties drive the motor by less than large ones, in proportion: exponential throttle, or "expo".

  Equation: V = u (1 - x (1 - (u / V_s)^2)), so that a full duty stays a full one.
  Units: x - (0 is a straight line, 1 a cubic; negative is gentler at the top), u and V V, V_s V the supply.
  Source: Cleanflight, rc_curves.c, 2014 (rcExpo8), the cubic that radios' expo is, too.
  Size: stated prior: 0.3 is what drivers set who want to be gentle about neutral; radios offer any from -1 to 1.
  Confounded with: drive_dead_zone, quadratic_drag, drive_limit where few duties were driven.
  """

  name = "drive_expo"
  subsystem = "drive"
  stage = "command"
  link = "device"
  outlined_by = "drive_curve"
  open_loop = True
  signed = True
  drives = ("duty",)
  parameters = (
    Parameter("drive_expo", 0.0, -0.9, 1.0, "-", "x", null=0.0, typical=0.3, description="cubic share of the throttle"),
  )

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting, duty = command.copy(), command[:, 0] / context.car.duty_supply
    acting[:, 0] *= 1.0 - theta[:, 0] * (1.0 - duty * duty)
    return acting
