"""What the wheels do with a steering command, as a curve of no known form."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import polyline

_KNOTS = np.array([-1.0, -2.0 / 3.0, -1.0 / 3.0, 0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
_PLACES = ("right_3", "right_2", "right_1", "left_1", "left_2", "left_3")


class SteeringCurve(Mechanism):
  """The wheels' angle departs from the command by a free curve, left and right on their own.

  Equation: delta = u + U sum_k c_k h_k(u / U), h_k hats about thirds of U; 0 in the middle, held beyond U.
  Units: c_k - (shares of U), U rad, the largest command driven; u, delta rad, left positive.
  Source: hat functions, de Boor, A Practical Guide to Splines, Springer, 2001, ch. III (piecewise linear).
  Size: stated prior: 0.075, as of steering_gain_error.
  Confounded with: every named error of the steering's map, which it is there to outline.
  """

  name = "steering_curve"
  subsystem = "steering"
  stage = "command"
  link = "geometry"
  open_loop = True
  symmetric = False
  signed = True
  curve = True
  parameters = (
    *(
      Parameter(f"steering_curve_{place}", 0.0, -0.8, 0.8, "-", f"c_{i}", null=0.0, typical=0.075,
                description="departure")
      for i, place in enumerate(_PLACES)
    ),
    Parameter("steering_curve_reach", 0.25, 0.02, 1.2, "rad", "U", std=1e-3, description="largest command"),
  )  # fmt: skip

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    reach, middle = theta[:, -1], len(_PLACES) // 2
    heights = np.zeros((len(theta), len(_KNOTS)))
    heights[:, :middle], heights[:, middle + 1 :] = theta[:, :middle], theta[:, middle:-1]
    acting = command.copy()
    acting[:, 1] += reach * polyline(command[:, 1] / reach, _KNOTS, heights)
    return acting
