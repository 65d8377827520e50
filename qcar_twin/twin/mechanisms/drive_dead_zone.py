"""Motor driver that swallows small voltages."""

from collections.abc import Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import dead_zone

CORNER = 0.01  # V
# V, a quarter of the usual supply: controllers that take pulses leave out up to 15 % of their range around neutral
# by default (VESC Tool, PPM input deadband), which shows as a voltage of the supply that is stated
LARGEST = 3.0
_BAND = 0.15  # of the supply: the default of such controllers


class DriveDeadZone(Mechanism):
  """Small voltages do not reach the motor, and large ones lose as much (driver and brush drop).

  Equation: V = sgn(u) max(|u| - b, 0).
  Units: b V; corners rounded over 10 mV.
  Source: Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996, ch. 2.
  Size: stated prior: 0.15 V is 1.4 % of three cells' 11.1 V, a tenth of the 15 % of range that controllers of pulses
    leave out by default (VESC Tool).
  Confounded with: coulomb_friction (follows the motion, not the voltage), stiction.
  """

  name = "drive_dead_zone"
  subsystem = "drive"
  stage = "command"
  link = "device"
  outlined_by = "drive_curve"
  open_loop = True
  fitted_rank = 26
  drives = ("voltage", "duty")
  parameters = (
    Parameter("drive_dead_zone", 0.0, 0.0, LARGEST, "V", "b", null=0.0, typical=0.15, description="voltage swallowed"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Few descriptions say whether a controller takes its duty as pulses: the usual band is three deviations."""
    return {"drive_dead_zone": _BAND * car.duty_supply / 3.0}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    acting[:, 0] = dead_zone(command[:, 0], theta[:, 0], CORNER)
    return acting
