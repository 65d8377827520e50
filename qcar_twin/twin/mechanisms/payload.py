"""Something heavy on board."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model


class Payload(Mechanism):
  """The car carries a mass that nobody weighed.

  Equation: m -> m + dm at distance dx ahead of the centre of gravity; I_z grows by the parallel-axis term
  m dm / (m + dm) dx^2.
  Units: dm kg, dx m.
  Source: Gillespie, Fundamentals of Vehicle Dynamics, SAE, 1992, ch. 1 (loads).
  Size: stated prior: 0.5 kg is a second battery and a camera, 19 % of 2.7 kg.
  Confounded with: torque per volt, back-EMF and friction all falling together; cornering stiffness.
  """

  name = "payload"
  subsystem = "body"
  stage = "contact"
  signed = True
  parameters = (
    Parameter("payload_mass", 0.0, -1.0, 2.5, "kg", "dm", null=0.0, typical=0.5, description="added mass"),
    Parameter("payload_x", 0.0, -0.15, 0.15, "m", "dx", description="its place ahead of the centre of gravity"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    before, mass = model.get("added_mass"), theta[:, 0]
    total = before + mass
    safe = total + (total == 0.0)
    model.set("added_mass", total)
    model.set("added_mass_x", (before * model.get("added_mass_x") + mass * theta[:, 1]) / safe)
