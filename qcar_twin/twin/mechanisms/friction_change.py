"""A floor or tyres that change while one drives."""

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import scale_grip

# s of the first drop that is tried, and from each to the next: so close that each sees the next one's flank
EARLIEST, RATIO = 30.0, 1.9


class FrictionChange(Mechanism):
  """Grip is different later on: tyres pick up dust, warm up, the floor changes.

  Equation: mu = mu_fitted (1 + x s), s = 1 - exp(-(t / t_0)^p), t the seconds driven so far in the data set.
  Units: x -, t_0 s, p - (1 creeps in, 20 drops at t_0), share -: part of the change that stiffness takes.
  Source: Gustafsson, Automatica 33(6), 1997 (slip-based friction estimation).
  Size: stated prior: 0.25 takes the friction coefficient from 0.8 to 0.6: about one deviation of its prior (a factor
    of 1.3).
  Confounded with: tyre_saturation where it is there from the start, battery_discharge.
  """

  name = "friction_change"
  subsystem = "ground"
  stage = "contact"
  varies = True
  signed = True
  nonlinear_response = True
  parameters = (
    Parameter("friction_change", 0.0, -0.8, 1.0, "-", "x", null=0.0, typical=0.25, description="relative, at last"),
    Parameter("friction_change_time", 60.0, 1.0, 3000.0, "s", "t_0", description="when it comes"),
    Parameter("friction_change_suddenness", 3.0, 0.7, 30.0, "-", "p", description="1 gradual, 20 at once"),
    Parameter("friction_change_stiffness", 0.5, 0.0, 1.0, "-", "share", description="share that stiffness takes"),
  )

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """A fast and a slow drift, and drops while the car was driven."""
    drifts = ({"friction_change_time": t, "friction_change_suddenness": 1.0} for t in (60.0, 300.0))
    count = 1 + int(max(np.log(driving.last / EARLIEST) / np.log(RATIO), 0.0))
    times = [t for t in EARLIEST * RATIO ** np.arange(count) if t > driving.first]
    drops = ({"friction_change_time": float(t), "friction_change_suddenness": 7.0} for t in times)
    return (*drifts, *drops)

  def observable_share(self, values: Mapping[str, float], driving: Driving) -> float:
    """What of the change falls into the middle four fifths of the driving; there must be some on either side of it."""
    first, last = driving.first, driving.last
    early, late = first + 0.1 * (last - first), last - 0.1 * (last - first)
    come = lambda t: _come(t, values["friction_change_time"], values["friction_change_suddenness"])
    return float(come(late) - come(early))

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    driven = context.history[:, 0] + context.time
    change = theta[:, 0] * _come(driven, theta[:, 1], theta[:, 2])
    scale_grip(model, change[:, None], theta[:, 3:])


def _come(driven: Array | float, time: Array | float, suddenness: Array | float) -> Array:
  """s, the share of the change that has come after so many seconds of driving."""
  exponent = suddenness * np.log(np.maximum(driven, 1e-6) / time)
  return -np.expm1(-np.exp(np.clip(exponent, -50.0, 6.0)))
