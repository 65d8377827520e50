"""The fixed rule counts what it says."""

import pytest

from calibration.concealed.examination.page import markdown_page, verdict, write_exam
from calibration.concealed.examination.score import characteristic, confusion, counts, power, reliability
from calibration.concealed.examination.sealed import Plan


def case(number, kind, effects=(), said=(), verdict="explained", best=("steering_lag", 0.4)):
  """One opened case: effects as (id, right names, nats), claims as (mechanism, probability)."""
  truth = [
    {"id": i, "right": list(right), "nats": nats, "size": 0.1, "unit": "s", "part": "steering"}
    for i, right, nats in effects
  ]
  claims = [{"mechanism": m, "probability": p, "indistinguishable_from": []} for m, p in said]
  scored = [{"set": [best[0]], "name": best[0], "at_bound": False, "probability": best[1]}]
  answer = {"verdict": verdict, "claims": claims, "scored": scored}
  return {"name": f"case_{number:03d}", "truth": {"kind": kind, "effects": truth}, "answer": answer}


DELAY, LAG = ("dead_time", ("steering_delay",), 300.0), ("servo", ("steering_lag",), 10.0)
CASES = [
  case(0, "null", verdict="no_mismatch"),
  case(1, "null", said=[("payload", 0.9)], best=("payload", 0.9)),
  case(2, "single", [DELAY], [("steering_delay", 0.95)], best=("steering_delay", 0.95)),
  case(3, "single", [LAG], [("steering_delay", 0.6)], best=("steering_delay", 0.6)),
  case(4, "pair", [DELAY, LAG], [("steering_delay", 0.7), ("steering_lag", 0.7)]),
  case(5, "outside", [("hunting", (), 90.0)], verdict="unexplained"),
]


def test_counts():
  tallied = {said: (hits, of) for said, hits, of in counts(CASES)}
  assert tallied["without an effect: something claimed"] == (1, 2)
  assert tallied["one effect: right name first"] == (1, 2)
  assert tallied["of those of 20 nats and more"] == (1, 1)
  assert tallied["one effect: a wrong name first"] == (1, 2)
  assert tallied["two effects: both named"] == (1, 1) == tallied["two effects: nothing false"]
  assert tallied["outside the catalogue: said so"] == (1, 1)


def test_a_figure_that_departs_the_other_way_is_wrong():
  high = case(0, "single", [("cg_height", ("load_transfer", "cg_height_offset"), 90.0)])
  for z, right in ((4.0, 1), (-4.0, 0)):
    high["answer"]["departures"] = [{"name": "cg_height_offset", "z": z}]
    tallied = {said: hits for said, hits, _ in counts([high])}
    assert tallied["one effect: right name first"] == right and tallied["one effect: a wrong name first"] == 1 - right


def test_power_characteristic_and_reliability():
  assert power(CASES) == [("5 to 20", 0, 1), ("100 to 500", 1, 1)]
  by_level = {level: (false, tallied) for level, false, tallied in characteristic(CASES)}
  assert by_level[0.5] == (0.5, 0.5) and by_level[0.95] == (0.0, 0.5) and by_level[0.35] == (1.0, 0.5)
  worth = {name: rest for name, *rest in reliability(CASES)}
  assert worth["0.65 to 0.8"] == pytest.approx([2, 0.7, 1.0]) and worth["0.5 to 0.65"] == pytest.approx([1, 0.6, 0.0])


def test_confusion_counts_cases_with_one_effect_and_none():
  rows, columns, table = confusion(CASES)
  assert table.sum() == 5 and rows[-1] == "nothing" and columns[-1] == "no claim"
  assert table[rows.index("steering"), columns.index("steering")] == 2


def test_the_page_has_every_case(tmp_path):
  plan = Plan("slipx", "c0ffee", True, 8)
  text = markdown_page(plan, CASES, "qcar-twin exam")
  assert "6 of 8 cases" in text and all(f"case_00{i}" in text for i in range(6)) and "sealed" in text
  assert "one effect: right name first, 1 of 2 (0.01 to 0.99)" in verdict(CASES)
  assert "Confusion matrix" in write_exam(tmp_path, plan, CASES, "qcar-twin exam").read_text()
