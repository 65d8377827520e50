"""Centre of gravity off the middle."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model


class CgLateralOffset(Mechanism):
  """The centre of gravity lies to one side, so driving force turns the car.

  Equation: M_z = e F_x about the centre of gravity, and the wheels of one side carry more.
  Units: e m, centre of gravity to the left of the middle.
  Source: Gillespie, Fundamentals of Vehicle Dynamics, SAE, 1992, ch. 1; Genta and Morello, The Automotive Chassis,
    2009.
  Size: stated prior: 0.014 m is where a battery of 0.45 kg over one side's wheels, 0.085 m off the middle, moves 2.7
    kg.
  Confounded with: steering_offset, drive_asymmetry, uneven tyres.
  """

  name = "cg_lateral_offset"
  subsystem = "body"
  stage = "contact"
  symmetric = False
  signed = True
  nonlinear_response = (
    True  # tyres and axles move far to make up for it, and a straight line from there leads elsewhere
  )
  parameters = (
    Parameter("cg_lateral_offset", 0.0, -0.06, 0.06, "m", "e", null=0.0, typical=0.014, description="to the left"),
  )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    model.set("cg_lateral_offset", model.get("cg_lateral_offset") + theta[:, 0])
