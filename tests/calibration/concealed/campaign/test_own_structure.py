"""Claims on the second car that are true of it though nothing was concealed."""

from typing import Any

import pytest

from calibration.concealed.campaign.own_structure import OWN, own_claims, own_table
from calibration.concealed.laboratory.designs import plan
from calibration.concealed.second_car import drawn_car, make_second_session
from calibration.concealed.second_car import session as second_session
from qcar_twin.twin.mechanisms import catalogue

LIMIT = 1.0 / drawn_car(7).servo_speed


def answered(told: float, car: str = "second", effects=(), mechanism: str = "steering_rate_limit") -> dict[str, Any]:
  parameters = {"steering_inverse_rate": {"value": told, "std": 0.01, "unit": "s/rad"}}
  return {
    "case": {"name": "null_00", "kind": "null", "seed": 7, "effects": list(effects), "car": car},
    "answer": {"claims": [{"mechanism": mechanism, "probability": 0.8, "parameters": parameters}]},
  }


def test_a_claim_is_set_beside_the_number_of_the_car_that_drove(monkeypatch):
  """The session is cut down to its shortest run."""
  shortest = lambda design, rng: [min(plan(design, rng), key=lambda run: run.ticks)]
  monkeypatch.setattr(second_session, "plan", shortest)
  (claim,) = own_claims([answered(LIMIT + 0.02)])
  assert claim.own == pytest.approx(LIMIT)
  assert claim.deviations == pytest.approx(2.0)
  assert make_second_session(7).truth["car"]["servo_speed"] == pytest.approx(1.0 / claim.own)
  assert "| null_00 | steering_rate_limit |" in own_table([answered(LIMIT + 0.02)])
  assert "+2.0" in own_table([answered(LIMIT + 0.02)])


@pytest.mark.parametrize(
  "other",
  [
    answered(LIMIT, car="first"),
    answered(LIMIT, effects=[["steering_rate_limit", 1.0]]),
    answered(LIMIT, mechanism="steering_lag"),
  ],
)
def test_what_was_concealed_and_what_such_cars_lack_is_not_listed(other):
  assert own_claims([other]) == [] and own_table([other]) == ""


def test_what_is_listed_is_in_the_catalogue_with_that_parameter():
  for name, (parameter, _) in OWN.items():
    assert parameter in [p.name for p in catalogue()[name].parameters]
