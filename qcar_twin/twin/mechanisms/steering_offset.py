"""Steering trim."""

from collections.abc import Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State

# rad, three deviations: who trims a car until it seems to run straight leaves half a degree, and the wheels then stand
# anywhere within the usual play and dead band, a quarter of a degree each to one side
_UNSEEN = 0.0175


class SteeringOffset(Mechanism):
  """The wheels point to one side when straight ahead is commanded.

  Equation: delta = u + delta_0.
  Units: delta_0 rad, positive to the left.
  Source: Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, sec. 2.3; Censi et al., IEEE T-RO 29(2), 2013.
  Size: stated prior: 0.035 rad is 2 deg, what trimming by eye leaves of half a tooth of a servo's spline, 7 deg with
    25 teeth.
  Confounded with: side_force, gyro_bias, floor_slope on a single heading.
  """

  name = "steering_offset"
  subsystem = "steering"
  stage = "command"
  outlined_by = "steering_curve"
  open_loop = True
  symmetric = False
  signed = True
  fitted_rank = 17
  parameters = (
    Parameter("steering_offset", 0.0, -0.2, 0.2, "rad", "delta_0", null=0.0, typical=0.035, description="trim, left"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """What nobody sees is three deviations."""
    return {"steering_offset": _UNSEEN / 3.0}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    acting[:, 1] += theta[:, 0]
    return acting
