"""The score of characterised wild cars counts names, shapes and ages as it says."""

import numpy as np
import pytest

from calibration.concealed.campaign.wild_score import is_shaped, names, shaped, wild_table, wild_verdict

HOLDOUT = {"yaw_rate": 0.02, "motor_speed": 1.0}


def curve(name, there, forms=()):
  named = {"mechanisms": list(forms), "values": {}, "std": {}} if forms else None
  return {"curve": name, "there": there, "named": named}


def term(name, value, there):
  return {"name": name, "value": value, "std": 0.1 * abs(value), "unit": "s", "there": there}


def result(curves, terms, additions, truth, sensors=None, worse=1.0):
  twin = {name: worse * value for name, value in HOLDOUT.items()}
  kinds = ("base", "curves", "characterised", "named", "black_box")
  answer = {
    "curves": curves,
    "terms": terms,
    "additions": [{"mechanism": name} for name in additions],
    "holdout": {k: twin for k in kinds},
    "best": "named",
  }
  case = {"name": "wild_00", "effects": [(t["id"], 1.0) for t in truth]}
  return {
    "case": case,
    "answer": answer,
    "truth": truth,
    "sensors": sensors,
    "oracle": {"holdout": HOLDOUT, "seen": [t["id"] for t in truth[:2]]},
  }


def effect(name, **parameters):
  return {"id": name, "in_catalogue": True, "parameters": parameters}


@pytest.fixture
def case():
  curves = [
    curve("steering_curve", True, ["steering_asymmetry"]),
    curve("drive_curve", True),
    curve("resistance_curve", False),
  ]
  terms = [
    term("encoder_latency", 0.055, True), term("imu_latency", 0.08, True), term("gyro_scale", 0.0, False),
    term("steering_offset@morning", 0.02, True),
  ]  # fmt: skip
  truth = [
    effect("steering_asymmetry", steering_asymmetry=0.1),
    effect("drive_chopped"),
    effect("stiction"),
    effect("imu_latency", imu_latency=0.03),
  ]
  return result(curves, terms, ["payload"], truth, {"speed_late": 0.05}, worse=1.5)


def test_names_are_forms_joiners_and_numbers_that_stand_out(case):
  assert names(case["answer"]) == {"steering_asymmetry", "payload", "encoder_latency", "imu_latency"}
  assert shaped(case["answer"]) == {"steering_curve", "drive_curve"}


def test_a_departing_curve_shapes_what_acts_on_its_map_and_nothing_else(case):
  assert is_shaped("drive_chopped", case["answer"]) and is_shaped("drive_asymmetry", case["answer"])
  assert not is_shaped("stiction", case["answer"]) and not is_shaped("coulomb_friction", case["answer"])


def test_the_table_counts_them(case):
  table = wild_table([case])
  rows = {
    row.split("|")[1].strip(): [cell.strip() for cell in row.split("|")[2:-1]]
    for row in table.splitlines()
    if "|" in row
  }
  assert rows["characterised"] == rows["shipped"] == ["1.50", "1.50"]
  assert (
    rows["names that are there"][0] == "3 of 4"
  )  # a late encoder is a sensor's way, no effect; payload is not there
  assert rows["effects of the catalogue, named"][0] == "2 of 4"
  assert rows["effects of the catalogue, named or shaped"][0] == "3 of 4"
  seen = [t["id"] for t in case["truth"][:2]]
  for label, told in (
    ("named", names(case["answer"])),
    ("named or shaped", {n for n in seen if is_shaped(n, case["answer"])}),
  ):
    assert rows[f"effects that the oracle sees, {label}"][0] == f"{len(told & set(seen))} of 2"
  assert rows["sensors' ages and scales within 10 ms or 10 %"][0] == "1 of 2"
  low, high = (float(x) for x in rows["effects of the catalogue, named or shaped"][2].split(" to "))
  assert low < 0.75 < high and np.isfinite([low, high]).all()


def counted(case, label):
  return next(row.split("|")[2].strip() for row in wild_table([case]).splitlines() if f" {label} |" in row)


def test_what_a_curve_nearly_is_counts_as_a_name(case):
  case["answer"]["curves"][1]["nearly"] = {"mechanisms": ["drive_dead_zone"]}
  assert "drive_dead_zone" in names(case["answer"]) and counted(case, "names that are there") == "3 of 5"


def test_the_mean_of_trims_that_are_reported_is_an_offset_and_both_counts_are_given(case):
  both = "the same, the mean of sessions' trims counted as an offset"
  case["answer"]["terms"].append(term("steering_offset", 0.005, True))
  assert counted(case, both) == "3 of 5"
  case["truth"].append({"id": "session_trim", "in_catalogue": False})
  assert counted(case, "names that are there") == "3 of 5" and counted(case, both) == "4 of 5"
  assert counted(case, "trims of sessions reported") == "1 of 1"
  case["answer"]["terms"][3]["there"] = False
  assert counted(case, both) == "3 of 5" and counted(case, "trims of sessions reported") == "0 of 1"


def test_the_outcome_in_a_sentence(case):
  assert "1.50 times as much" in wild_verdict([case]) and "3 of 4 names" in wild_verdict([case])
  assert wild_verdict([]) == "No session has been answered yet."
