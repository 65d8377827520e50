"""A floor or tyres that change while one drives."""

from collections.abc import Mapping, Sequence

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import changes_tried, come, come_amid, scale_grip


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
    return [
      {"friction_change_time": time, "friction_change_suddenness": sudden} for time, sudden in changes_tried(driving)
    ]

  def observable_share(self, values: Mapping[str, float], driving: Driving) -> float:
    return come_amid(values["friction_change_time"], values["friction_change_suddenness"], driving)

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    driven = context.history[:, 0] + context.time
    change = theta[:, 0] * come(driven, theta[:, 1], theta[:, 2])
    scale_grip(model, change[:, None], theta[:, 3:])
