"""Sessions without an effect of cars whose figures are known, and those figures as parameters of the twin."""

from collections.abc import Mapping
from typing import Any

from calibration.concealed.exam.session import make_exam_session
from calibration.concealed.proving_ground import make_session
from calibration.concealed.second_car import make_second_session
from qcar_twin.vehicle.vehicle import GRAVITY

CARS = {
  "first": lambda seed: make_session(seed, (), "compact"),
  "second": lambda seed: make_second_session(seed, (), "compact"),
  "slipx": lambda seed: make_exam_session("slipx", seed, bench=True),
}
"""Sessions without an effect, by generator and seed."""
_BODY = ("mass", "yaw_inertia", "cg_to_front")


def stated(car: str, truth: Mapping[str, Any]) -> dict[str, float]:
  """Parameters of the twin that a generator states in the same sense, by name, SI.

  Args:
    car: "first" or "second".
    truth: of the session.
  """
  known = truth["car"]
  body = {name: known[name] for name in _BODY}
  if car == "first":
    linear = truth["linearised"]
    return body | {
      "cornering_stiffness_front": linear["cornering_stiffness_front"],
      "cornering_stiffness_rear": linear["cornering_stiffness_rear"],
      "longitudinal_stiffness": 4.0 * known["slip_stiffness"],
      "friction_coefficient": known["friction"],
      "relaxation_length": known["relaxation"],
    }
  # its bristles' stiffness is per load, and a force builds up over half a patch; its friction falls with the slide
  weight, wheelbase = known["mass"] * GRAVITY, known["cg_to_front"] + known["cg_to_rear"]
  return body | {
    "cornering_stiffness_front": known["cornering_front"] * weight * known["cg_to_rear"] / wheelbase,
    "cornering_stiffness_rear": known["cornering_rear"] * weight * known["cg_to_front"] / wheelbase,
    "longitudinal_stiffness": known["slip_stiffness"] * weight,
    "relaxation_length": 0.5 * known["patch_length"],
  }
