"""Chopped supply: the motor is on the pack for a share of the time and open for the rest."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import idle_voltage


class DriveChopped(Mechanism):
  """The motor's back-EMF brakes only while the transistor conducts, so thrust is a product of command and speed.

  Equation: V = u + x (1 - |u| / U) e, e the back-EMF: x = 1 leaves torque = d K (U - e) / R at duty d = |u| / U.
  Units: x -, U V: the supply, the command at which the transistor conducts all the time.
  Source: Hughes and Drury, Electric Motors and Drives, 4th ed., 2013, ch. 4 (chopper drives, discontinuous current).
  Size: stated prior: 0.5 is the middle of the range from 0 to 1.
  Confounded with: motor damping, while commands are small compared with the supply; coast_freewheel at rest of command.
  """

  name = "drive_chopped"
  subsystem = "drive"
  stage = "actuator"
  link = "device"
  outlined_by = "drive_curve"
  whole = ("drive_chopped",)  # diodes alone carry what the motor has when the transistor is off
  drives = ("voltage", "duty")
  absorbed_by_drive = True
  parameters = (
    Parameter("drive_chopped", 0.0, 0.0, 1.0, "-", "x", null=0.0, typical=0.5, description="back-EMF taken away"),
    Parameter("drive_chopped_supply", 8.0, 1.0, 30.0, "V", "U", std=6.0, description="command that conducts always"),
  )

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    open_share = np.maximum(1.0 - np.abs(command[:, 0]) / theta[:, 1], 0.0)
    acting = command.copy()
    acting[:, 0] += theta[:, 0] * open_share * idle_voltage(context)
    return acting
