"""What holds the car back at each speed, as a curve of no known form."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import STANDSTILL, polyline
from qcar_twin.vehicle.vehicle import GRAVITY

_KNOTS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_CRAWL = 0.05  # share of the highest speed below which the car crawls


class ResistanceCurve(Mechanism):
  """A force against the motion that is a free curve of the speed, over and above what the base car has.

  Equation: F = -m g tanh(v / v_0) (r_c max(1 - |v| / 0.05 V, 0) + sum_k r_k h_k(|v| / V)), h_k hats, 0 at rest, held
  beyond V; v_0 = 0.05 m/s. Crawling has a number of its own, r_c: dry friction changes there within a few cm/s.
  Units: r_k, r_c - (shares of the weight m g); V m/s, the highest speed driven; F N.
  Source: hat functions, de Boor, A Practical Guide to Splines, Springer, 2001, ch. III (piecewise linear).
  Size: 0.01 is the low end of the 0.01 to 0.04 of rolling resistance coefficients in Rajamani, Vehicle Dynamics and
    Control, 2nd ed., 2012, sec. 4.1.4.
  Confounded with: motor damping, quadratic_drag and every other resistance, which it is there to outline.
  """

  name = "resistance_curve"
  subsystem = "drive"
  stage = "force"
  signed = True
  curve = True
  parameters = (
    *(
      Parameter(f"resistance_{i}", 0.0, -0.2, 0.5, "-", f"r_{i}", null=0.0, typical=0.01,
                description="force")
      for i in range(1, len(_KNOTS))
    ),
    Parameter("resistance_crawling", 0.0, -0.2, 0.5, "-", "r_c", null=0.0, typical=0.01, description="at a crawl"),
    Parameter("resistance_curve_reach", 1.5, 0.1, 40.0, "m/s", "V", std=1e-3, description="highest speed"),
  )  # fmt: skip

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    speed = context.signal("velocity_x")
    share, heights = np.abs(speed) / theta[:, -1], np.zeros((len(theta), len(_KNOTS)))
    heights[:, 1:] = theta[:, :-2]
    resisting = polyline(share, _KNOTS, heights) + theta[:, -2] * np.maximum(1.0 - share / _CRAWL, 0.0)
    force = np.zeros((len(theta), 3))
    weight = GRAVITY * context.car.mass * np.tanh(speed / STANDSTILL)
    force[:, 0] = -weight * resisting
    return force
