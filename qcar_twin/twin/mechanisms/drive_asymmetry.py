"""Drive that pulls back differently than it pulls forward."""

from collections.abc import Mapping, Sequence

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import idle_voltage, ramp

CORNER = 0.02  # in the unit of the command


class DriveAsymmetry(Mechanism):
  """Braking and reverse force differ from forward force for the same current or voltage.

  Equation: V = u - a ((1 - s) max(e - u, 0) + s max(-u, 0)): a negative torque k (u - e), for s = 1 a negative
  voltage, is 1 + a times what it should be. So is a negative current, and an acceleration that is commanded: there u is
  the command and e what friction takes of it, next to nothing.
  Units: a -, s - (0 by the sign of the torque, 1 by that of the command), u and e (back-EMF) V or as the command.
  Source: Hughes and Drury, Electric Motors and Drives, 4th ed., 2013, ch. 4 (four-quadrant operation).
  Size: stated prior: 0.1, brushes advanced for one direction, or a controller whose brake has a limit of its own.
  Confounded with: coast_freewheel, motor damping where the car only drives forward.
  """

  name = "drive_asymmetry"
  subsystem = "drive"
  stage = "actuator"
  link = "device"
  drives = ("voltage", "duty", "current", "acceleration")
  signed = True
  parameters = (
    Parameter("drive_asymmetry", 0.0, -0.6, 0.6, "-", "a", null=0.0, typical=0.1, description="relative, backwards"),
    Parameter("drive_asymmetry_by_voltage", 0.3, 0.0, 1.0, "-", "s", description="0 by torque, 1 by command"),
  )

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """By the sign of the torque, and of the voltage."""
    return ({"drive_asymmetry_by_voltage": 0.05}, {"drive_asymmetry_by_voltage": 0.95})

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    voltage, share = command[:, 0], theta[:, 1]
    braking = ramp(idle_voltage(context) - voltage, CORNER)
    reverse = ramp(-voltage, CORNER)
    acting = command.copy()
    acting[:, 0] -= theta[:, 0] * ((1.0 - share) * braking + share * reverse)
    return acting
