"""Steering linkage that turns further to one side."""

from collections.abc import Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import smooth_abs

_TOOTH = 0.032  # of a crank half a tooth of a servo's spline off square, 7 deg with 25 teeth, at half a radian


class SteeringAsymmetry(Mechanism):
  """The same command turns the wheels further to the left than to the right.

  Equation: delta = u + a |u|, so the gain is 1 + a to the left and 1 - a to the right.
  Units: a -, delta and u rad; the corner at zero is rounded over 1 mrad.
  Source: Milliken and Milliken, Race Car Vehicle Dynamics, SAE, 1995, ch. 19 (steering linkage geometry).
  Size: stated prior: 0.1 is a crank 22 deg off square at half a radian, tan(22 deg) x 0.5 / 2.
  Confounded with: steering_offset where only one amplitude of steering was driven.
  """

  name = "steering_asymmetry"
  subsystem = "steering"
  stage = "command"
  link = "geometry"
  outlined_by = "steering_curve"
  open_loop = True
  symmetric = False
  signed = True
  fitted_rank = 29
  parameters = (
    Parameter("steering_asymmetry", 0.0, -0.5, 0.5, "-", "a", null=0.0, typical=0.1, description="left over mean, - 1"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """A crank is put on to the nearest tooth: half a tooth is three deviations."""
    return {"steering_asymmetry": _TOOTH / 3.0}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    acting[:, 1] += theta[:, 0] * smooth_abs(command[:, 1])
    return acting
