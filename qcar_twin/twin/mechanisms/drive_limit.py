"""A controller that limits the motor's current."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import idle_voltage, ramp, rolling_torque

CORNER = 0.02  # in the unit of the command
_LETS_GO = 20.0  # s^2/m: 0.05 m/s^2, half of what the best tyres' rolling resistance takes, 0.01 g (Gillespie, 1992)


class DriveLimit(Mechanism):
  """The motor gets no more than a limited current, another one where it brakes than where it drives.

  Equation: u' = e + sgn(u - e) min(|u - e|, m r_w G / (k l)): a force at the wheels of at most m / l; l = l_d where it
  goes with the motion and at rest, l_b where it goes against it.
  Units: l s^2/m, one over the acceleration that the limit allows: 0 is none, 0.5 is 2 m/s^2; u, e (back-EMF) and k
  (motor torque per command) as the command; corners rounded over 0.02 of its unit.
  Source: Hughes and Drury, Electric Motors and Drives, 4th ed., 2013, ch. 4 (current limit); controllers have one for
    the motor and one for braking (VESC Tool, motor current max and max brake).
  Size: stated prior: 0.5 s^2/m, so 2 m/s^2, a quarter of what tyres of friction 0.8 hold. Speed controllers with diodes
    in place of transistors do not brake at all while they drive: 20 s^2/m.
  Confounded with: drive_asymmetry and battery_sag, which take a share of every command and not what is above a limit.
  """

  name = "drive_limit"
  subsystem = "drive"
  stage = "actuator"
  link = "device"
  drives = ("voltage", "duty", "current", "acceleration")
  nonlinear_response = True
  from_threshold = True
  whole = ("drive_limit_braking",)
  parameters = (
    Parameter("drive_limit", 0.0, 0.0, 4.0, "s^2/m", "l_d", null=0.0, typical=0.5, description="driving"),
    Parameter("drive_limit_braking", 0.0, 0.0, _LETS_GO, "s^2/m", "l_b", null=0.0, typical=0.5, description="braking"),
  )

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    per_acceleration = rolling_torque(context.car.mass * np.ones(len(theta)), context) / context.torque_per_volt
    drawn = command[:, 0] - idle_voltage(context)
    braking = drawn * context.signal("motor_speed") < 0.0
    inverse = np.where(braking, theta[:, 1], theta[:, 0])
    limit = per_acceleration / np.maximum(inverse, 1e-9)
    acting = command.copy()
    acting[:, 0] -= np.sign(drawn) * ramp(np.abs(drawn) - limit, CORNER)
    return acting
