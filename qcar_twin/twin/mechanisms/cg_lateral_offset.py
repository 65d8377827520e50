"""Centre of gravity off the middle."""

from collections.abc import Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model
from qcar_twin.vehicle.similarity import Similarity

_BESIDE = 0.0075  # m: a battery of 0.45 kg of 2.7 kg, 0.045 m off the middle, as one beside a shaft is


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
  fitted_rank = 32
  parameters = (
    Parameter("cg_lateral_offset", 0.0, -0.06, 0.06, "m", "e", null=0.0, typical=0.014, description="to the left"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Few weigh a car's sides: a battery that lies beside the middle is three deviations."""
    return {"cg_lateral_offset": _BESIDE / 3.0 * Similarity.of(car.wheelbase).length}

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    model.set("cg_lateral_offset", model.get("cg_lateral_offset") + theta[:, 0])
