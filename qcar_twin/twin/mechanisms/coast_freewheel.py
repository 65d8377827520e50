"""Motor driver that lets go at zero."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import idle_voltage


class CoastFreewheel(Mechanism):
  """At zero command the driver opens the circuit instead of braking the motor.

  Equation: V = u + x w (e - u), w = 1 / (1 + (u / u_0)^4), e the back-EMF: x = 1 takes all of the motor's braking away.
  Units: x -, u_0 V: the command below which the driver lets go.
  Source: Hughes and Drury, Electric Motors and Drives, 4th ed., 2013, ch. 4 (chopper drives, coasting).
  Size: stated prior: 0.6 is a little more than half of the range: a driver that opens the circuit for most of each
    period.
  Confounded with: motor damping, coulomb_friction in coast-downs; drive_asymmetry.
  """

  name = "coast_freewheel"
  subsystem = "drive"
  stage = "actuator"
  link = "device"
  outlined_by = "drive_curve"
  whole = ("coast_freewheel",)  # the circuit is open
  drives = ("voltage", "duty")
  parameters = (
    Parameter("coast_freewheel", 0.0, 0.0, 1.0, "-", "x", null=0.0, typical=0.6, description="braking taken away"),
    Parameter("coast_freewheel_voltage", 0.1, 0.01, 0.8, "V", "u_0", description="command that counts as zero"),
  )

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    ratio = np.minimum(np.abs(command[:, 0]) / theta[:, 1], 1e3) ** 2
    acting = command.copy()
    acting[:, 0] += theta[:, 0] / (1.0 + ratio * ratio) * (idle_voltage(context) - command[:, 0])
    return acting
