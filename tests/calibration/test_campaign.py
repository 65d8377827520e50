"""Campaigns: one seed decides all cases, the fixed score counts what it says, an answer is not made twice."""

import json

import pytest

from calibration.campaign import Case, draw_cases, run_case
from calibration.campaign_score import score, score_table
from qcar_twin.mechanisms import catalogue


def result(kind, truth, claims=(), ranking=(), equivalent=(), subsystem="steering", verdict=None, values=None, worse=1.0):
  """One answered case; claims and truth as (id, size)."""
  named = [
    {"mechanism": c, "probability": 0.9, "equivalent_to": list(equivalent),
     "parameters": {k: {"value": v} for k, v in (values or {}).items()}}
    for c in claims
  ]  # fmt: skip
  answer = {
    "verdict": verdict or ("explained" if claims else "no_mismatch"),
    "claims": named,
    "ranking": [{"mechanism": m} for m in (ranking or claims)],
    "where": {"subsystem": subsystem},
    "fit": {"holdout": {"yaw_rate": {"before": 1.0, "after": worse}}},
    "recovered": 0.9,
    "seconds": 60.0,
  }
  stated = [{"id": i, "parameters": {"steering_delay": 0.04} if i == "steering_delay" else {}} for i, _ in truth]
  return {"case": {"name": f"{kind}_0", "kind": kind, "seed": 1, "effects": truth}, "truth": stated, "answer": answer}


DELAY = [("steering_delay", 1.0)]


def test_singles_are_counted_by_their_first_claim():
  results = [
    result("single", DELAY, ["steering_delay"], values={"steering_delay": 0.044}),
    result("single", DELAY, ["steering_lag"], ranking=["steering_lag", "steering_delay"], equivalent=["steering_delay"]),
    result("single", [("steering_delay", 1 / 3)], [], ranking=["gyro_scale"], subsystem="none"),
    result("single", DELAY, ["gyro_scale"], ranking=["gyro_scale"], subsystem="sensor", worse=1.02),
  ]
  found = score(results)
  assert found["right_first"] == 0.25
  assert found["right_or_declared_equivalent"] == 0.5
  assert found["top_three"] == 0.5
  assert found["no_claim"] == 0.25
  assert found["wrong_first"] == 0.5
  assert found["subsystem"] == 0.5
  assert found["parameter_error_median"] == pytest.approx(0.1)
  assert found["channels_worse"] == pytest.approx(1 / 3)


def test_pairs_want_both_and_nothing_false():
  both = [("steering_delay", 1.0), ("payload", 1.0)]
  found = score([
    result("pair", both, ["payload", "steering_delay"]),
    result("pair", both, ["payload"]),
    result("pair", both, ["payload", "gyro_scale"]),
    result("pair", both, ["gyro_scale"]),
  ])  # fmt: skip
  assert found["pairs_both"] == 0.25
  assert found["pairs_at_least_one"] == 0.75
  assert found["pairs_nothing_false"] == 0.5


def test_nulls_and_strangers():
  found = score([
    result("null", []),
    result("null", [], ["gyro_scale"]),
    result("outside", [("carpet_pile", 1.0)], ["gyro_scale"]),
    result("outside", [("side_wind", 1.0)], [], verdict="unexplained"),
  ])  # fmt: skip
  assert found["nulls_with_claim"] == 1
  assert found["outside_unknown"] == 0.5
  assert found["outside_sure_and_wrong"] == 0.5
  assert found["right_first"] is None


def test_the_table_lists_every_case():
  table = score_table([result("null", []), result("single", DELAY, ["steering_delay"])])
  assert "| nulls | 1 |" in table
  assert "steering_delay x 1 | explained | steering_delay (0.90)" in table


def test_one_seed_decides_everything_and_two_seeds_differ():
  assert draw_cases(3, 4, 6, 2, 2) == draw_cases(3, 4, 6, 2, 2)
  assert {c.seed for c in draw_cases(3, 4, 6, 2, 2)}.isdisjoint(c.seed for c in draw_cases(4, 4, 6, 2, 2))


def test_a_campaign_spreads_over_the_catalogue_and_its_pairs_over_subsystems():
  cases = draw_cases(5, 3, 40, 12, 6)
  singles = [c for c in cases if c.kind == "single"]
  assert len({c.effects[0][0] for c in singles}) == 40
  assert {round(c.effects[0][1], 3) for c in singles} == {1.0, 0.333}
  known = catalogue()
  for case in cases:
    if case.kind == "pair":
      assert len({known[name].subsystem for name, _ in case.effects}) == 2
    if case.kind == "outside":
      assert case.effects[0][0] not in known


def test_an_answer_that_is_there_is_kept(tmp_path):
  case = Case("null_00", "null", 1, (), 1.0)
  path = tmp_path / "null_00.json"
  path.write_text(json.dumps({"kept": True}))
  assert run_case(case, tmp_path) == path
  assert json.loads(path.read_text()) == {"kept": True}
