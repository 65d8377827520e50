"""Campaigns: one seed decides all cases, the fixed score counts what it says, an answer is not made twice."""

import json

import pytest

from calibration.concealed.campaign import run
from calibration.concealed.campaign.archive import digest, pack, read_answer, unpack
from calibration.concealed.campaign.cases import Case, draw_cases
from calibration.concealed.campaign.figure import confusion_table
from calibration.concealed.campaign.nulls import spurious, spurious_table
from calibration.concealed.campaign.page import AIMS, campaign_page
from calibration.concealed.campaign.report import sections, verdict
from calibration.concealed.campaign.run import run_case
from calibration.concealed.campaign.score import (
  both_seen,
  error_over,
  expected_error,
  null_floor,
  recovered,
  reliability,
  right_variables,
  score,
  score_baselines,
  score_table,
  stated_claims,
  worse_than_right_model,
)
from calibration.concealed.proving_ground import EFFECTS
from calibration.diagnosis.decision.structure import PROPERTIES
from qcar_twin.twin.mechanisms import catalogue


def result(
  kind,
  truth,
  claims=(),
  ranking=(),
  equivalent=(),
  subsystem="steering",
  verdict=None,
  values=None,
  worse=1.0,
  nats=500.0,
):
  """One answered case; claims and truth as (id, size)."""
  named = [
    {"mechanism": c, "probability": 0.9, "indistinguishable_from": list(equivalent),
     "parameters": {k: {"value": v, "std": 0.001} for k, v in (values or {}).items()}}
    for c in claims
  ]  # fmt: skip
  answer = {
    "verdict": verdict or ("explained" if claims else "no_mismatch"),
    "claims": named,
    "ranking": [{"mechanism": m} for m in (ranking or claims)],
    "where": {"subsystem": subsystem},
    "fit": {
      "holdout": {
        "yaw_rate": {
          "before": 1.0,
          "after": worse,
          "noise_floor": 0.1,
          "driving_noise": 0.2,
          "ci95": [worse - 1.03, worse - 0.9],
        }
      }
    },
    "seconds": 60.0,
  }
  stated = [{"id": i, "parameters": {"steering_delay": 0.04} if i == "steering_delay" else {}} for i, _ in truth]
  case = {"name": f"{kind}_0", "kind": kind, "seed": 1, "effects": truth, "noise": 1.0, "design": "compact"}
  oracle = {"nats": nats, "holdout": {"yaw_rate": 0.4}}
  methods = {
    "white_noise_bic": {"claims": ["gyro_scale"], "ranking": [["gyro_scale", 9.0]], "holdout": {"yaw_rate": 0.8}}
  }
  return {"case": case, "truth": stated, "answer": answer, "oracle": oracle if truth else None, "baselines": methods}


DELAY = [("steering_delay", 1.0)]


def test_singles_are_counted_by_their_first_claim():
  results = [
    result("single", DELAY, ["steering_delay"], values={"steering_delay": 0.044}),
    result(
      "single", DELAY, ["steering_lag"], ranking=["steering_lag", "steering_delay"], equivalent=["steering_delay"]
    ),
    result("single", [("steering_delay", 1 / 3)], [], ranking=["gyro_scale"], subsystem="none"),
    result("single", DELAY, ["gyro_scale"], ranking=["gyro_scale"], subsystem="sensor", worse=1.02),
  ]
  figures = score(results)
  assert figures["right_first"] == 0.25
  assert figures["right_or_declared_indistinguishable"] == 0.5
  assert figures["top_three"] == 0.5
  assert figures["no_claim"] == 0.25
  assert figures["wrong_first"] == 0.5
  assert figures["subsystem"] == 0.5
  assert figures["parameter_error_median"] == pytest.approx(0.1)
  assert figures["channels_worse"] == pytest.approx(1 / 3)
  assert figures["channels_worse_of_all_cases"] == 0.25
  assert figures["channels_worse_beyond_chance"] == 0.0
  assert score([result("single", DELAY, ["gyro_scale"], worse=1.04)])["channels_worse_beyond_chance"] == 1.0


def test_stated_probabilities_are_set_against_how_often_they_were_right():
  results = [result("single", DELAY, [name]) for name in ("steering_delay", "gyro_scale")]
  rows = reliability(stated_claims([*results, result("null", [], [])]))
  assert [row[2] for row in rows] == [0, 0, 2, 0]
  assert rows[2][3:] == (pytest.approx(0.9), 0.5) and rows[0][3:] == (None, None)


def test_cases_are_graded_by_what_the_right_model_would_bring():
  figures = score([result("single", DELAY, ["steering_delay"], nats=n) for n in (2000.0, 500.0, 500.0)]
                + [result("single", DELAY, [], nats=n) for n in (400.0, 30.0, 5.0)])  # fmt: skip
  assert (figures["right_first_easy"], figures["right_first_hard"], figures["as_good_as_invisible"]) == (1.0, 0.0, 1)
  assert figures["right_first_medium"] == pytest.approx(2 / 3)


def test_intervals_that_hold_the_truth_are_counted():
  cases = [result("single", DELAY, ["steering_delay"], values={"steering_delay": v}) for v in (0.041, 0.044)]
  assert score(cases)["coverage_90"] == 0.5


def test_stated_probabilities_miss_by_what_they_say_less_what_is_right():
  """Two claims at 0.9 of which one is right: off by 0.4."""
  assert expected_error([(0.9, True), (0.9, False)]) == pytest.approx(0.4)
  assert expected_error([]) is None


def test_a_nameless_effect_is_right_if_its_strongest_property_is_one_of_its_formula():
  case = result("outside", [("side_wind", 1.0)], [], verdict="unexplained")
  for properties, right in ((["turns with the heading", "periodic"], True), (["periodic"], False), ([], False)):
    case["answer"]["unknown"] = {"properties": properties}
    assert right_variables(case) == right
  assert score([case])["outside_unknown"] == 1.0


def test_every_effect_outside_the_catalogue_says_what_carries_it():
  for effect in EFFECTS.values():
    if not effect.catalogue and not effect.wild:
      assert effect.carried_by and set(effect.carried_by) <= set(PROPERTIES), effect.id


def test_pairs_are_apart_of_which_one_leaves_nothing():
  pair = result("pair", [*DELAY, ("payload", 1.0)], ["steering_delay"])
  pair["oracle"]["lost_without"] = {"steering_delay": 900.0, "payload": 1.5}
  assert not both_seen(pair)
  pair["oracle"]["lost_without"]["payload"] = 25.0
  assert both_seen(pair)


def test_a_channel_may_be_worse_because_the_right_model_is():
  for worse, right in ((1.02, 1.05), (1.02, 0.9)):
    case = result("single", DELAY, ["steering_delay"], worse=worse)
    case["oracle"]["holdout"] = {"yaw_rate": right}
    assert worse_than_right_model(case) == (worse > 1.01 * right)


def test_recovered_share_counts_what_lies_above_a_floor():
  null, case = result("null", []), result("single", DELAY, ["steering_delay"], worse=0.6)
  null["answer"]["fit"]["holdout"]["yaw_rate"]["before"] = 0.5
  assert null_floor([null]) == {"yaw_rate": 0.5}
  assert recovered(case, {"yaw_rate": 0.5}) == pytest.approx((1.0 - 0.36) / (1.0 - 0.25))
  assert recovered(case, {"yaw_rate": 0.99}) is None  # nothing above the floor to recover
  assert error_over(case, {"yaw_rate": 0.4}) == pytest.approx(1.5)


def test_the_simpler_methods_are_scored_on_the_same_cases():
  rows = score_baselines([result("null", []), result("single", DELAY, ["steering_delay"], worse=0.5)])
  assert rows["white_noise_bic"]["nulls_with_claim"] == 1
  assert rows["white_noise_bic"]["right_first"] == 0.0
  assert rows["white_noise_bic"]["holdout_error_median"] == pytest.approx(0.8)
  assert rows["diagnosis"] == {
    "nulls_with_claim": 0,
    "right_first": 1.0,
    "wrong_first": 0.0,
    "holdout_error_median": 0.5,
  }


def test_confusion_counts_first_claims_by_truth():
  cases = [result("single", DELAY, ["steering_delay"]), result("single", DELAY, ["gyro_scale"]), result("null", [])]
  truths, answers, table = confusion_table(cases)
  assert table[truths.index("steering_delay"), answers.index("gyro_scale")] == 1
  assert table[truths.index("nothing"), answers.index("no claim")] == 1
  assert table.sum() == 3


def test_the_page_sets_every_aim_beside_what_was_found(tmp_path):
  cases = [result("null", []), result("single", DELAY, ["steering_delay"])]
  text = campaign_page(cases, 5, "python x", tmp_path / "seed.png")
  assert "2 of 5 sessions" in text and "compact (129 s of driving in 15 recordings)" in text
  assert "(seed.png)" in text and (tmp_path / "seed.png").stat().st_size > 1000
  assert "| single effects: right name first | >= 0.9 | 1 |" in text
  assert "| sessions without an effect in which something was claimed | <= 0.034 | 0 |" in text
  assert all(meaning in text for _, meaning, _ in AIMS) and set(n for n, _, _ in AIMS) <= set(score(cases))


def test_the_report_says_how_often_the_right_name_came_first():
  cases = [result("null", []), result("single", DELAY, ["steering_delay"]), result("single", DELAY, ["gyro_scale"])]
  assert verdict(cases) == (
    "The right name came first in 50 % of 2 sessions with one effect; something was claimed in 0 of 1 sessions without"
    " any."
  )
  assert verdict([]) == "No session has been answered yet." and len(sections([])) == 1
  parts = {part.title: part for part in sections(cases)}
  assert len(parts["Every case"].tables[0].rows) == 3 and len(parts["Aims"].tables[0].rows) == len(AIMS)
  chart = parts["Confusion matrix"].figures[0].data()["traces"][0]
  assert sum(v or 0 for row in chart["z"] for v in row) == 3


def test_pairs_want_both_and_nothing_false():
  both = [("steering_delay", 1.0), ("payload", 1.0)]
  figures = score([
    result("pair", both, ["payload", "steering_delay"]),
    result("pair", both, ["payload"]),
    result("pair", both, ["payload", "gyro_scale"]),
    result("pair", both, ["gyro_scale"]),
  ])  # fmt: skip
  assert figures["pairs_both"] == 0.25
  assert figures["pairs_at_least_one"] == 0.75
  assert figures["pairs_nothing_false"] == 0.5


def test_nulls_and_strangers():
  figures = score([
    result("null", []),
    result("null", [], ["gyro_scale"]),
    result("outside", [("carpet_pile", 1.0)], ["gyro_scale"]),
    result("outside", [("side_wind", 1.0)], [], verdict="unexplained"),
  ])  # fmt: skip
  assert figures["nulls_with_claim"] == 1
  assert figures["outside_unknown"] == 0.5
  assert figures["outside_sure_and_wrong"] == 0.5
  assert figures["right_first"] is None


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


def test_what_nulls_let_mechanisms_reach():
  def tried(kind, *trials):
    case = result(kind, DELAY if kind == "single" else [])
    case["answer"]["trials"] = [
      {"set": names, "t": t, "gain": gain, "sizes": {"a": [0.02, 0.001, 0.1], "b": [size, 0.01, 1.0]}}
      for names, t, gain, size in trials
    ]
    return case

  nulls = [
    tried("null", (["pose_mount"], 2.5, 30.0, -0.3), (["cogging"], 1.0, 90.0, 5.0), (["cogging"], 3.0, 5.0, 5.0)),
    tried("null", (["pose_mount"], 3.5, 20.0, 0.1), (["cogging", "payload"], 9.0, 99.0, 1.0)),
    tried("single", (["steering_delay"], 9.0, 500.0, 1.0)),
  ]
  assert spurious(nulls) == [("pose_mount", 2, 30.0, 3.5, 0.3)]
  assert "| pose_mount | 2 | 30 | 3.5 | 0.30 |" in spurious_table(nulls)


def test_an_archive_gives_back_every_answer_and_keeps_those_that_are_there(tmp_path):
  made = tmp_path / "made"
  made.mkdir()
  for name, size in (("null_00", 0.1), ("single_03", 0.30000000000000004)):
    answer = {"verdict": "explained", "size": size, "claims": []}
    whole = {"case": {"name": name}, "answer": answer, "sha256": digest(answer), "truth": []}
    (made / f"{name}.json").write_text(json.dumps(whole, indent=1))
  archive, again = tmp_path / "answers.jsonl.xz", tmp_path / "again"
  assert pack(made, archive) == 2
  assert unpack(archive, again) == 2 and unpack(archive, again) == 0
  for path in made.iterdir():
    assert json.loads((again / path.name).read_text()) == json.loads(path.read_text())
  assert not list(tmp_path.rglob(".writing-*"))


def test_an_answer_that_was_changed_later_is_not_taken_from_an_archive(tmp_path):
  whole = {
    "case": {"name": "null_00"},
    "answer": {"verdict": "explained"},
    "sha256": digest({"verdict": "no_mismatch"}),
  }
  (tmp_path / "null_00.json").write_text(json.dumps(whole))
  pack(tmp_path, tmp_path / "answers.jsonl.xz")
  with pytest.raises(ValueError, match="null_00 was changed"):
    unpack(tmp_path / "answers.jsonl.xz", tmp_path / "again")
  assert not list((tmp_path / "again").iterdir())


def test_an_answer_sealed_under_earlier_keys_is_read_under_those_of_now(tmp_path):
  sealed = {"rival": None, "possible": ["payload"], "left_over": {}}
  sealed |= {"claims": [{"mechanism": "ice", "rivals": [{"evidence_nats": 0.3}], "equivalent_to": ["worn_tyres"]}]}
  path = tmp_path / "single_00.json"
  path.write_text(json.dumps({"case": {}, "answer": sealed, "sha256": digest(sealed), "truth": []}))
  answer = read_answer(path)["answer"]
  assert answer == {
    "alternative": None, "below_detection_size": ["payload"],
    "residual_structure": {}, "claims": [{"mechanism": "ice", "alternatives": [{"evidence_nats": 0.3}],
    "indistinguishable_from": ["worn_tyres"]}],
  }  # fmt: skip
  path.write_text(json.dumps({"case": {}, "answer": answer}))
  assert read_answer(path)["answer"] == answer


def test_a_case_that_ends_in_an_error_is_told_of_and_tried_again(tmp_path, monkeypatch):
  case, folder = Case("null_00", "null", 1, (), 1.0), tmp_path / "out"

  def broken(*_, **__):
    raise ValueError("no minimum")

  monkeypatch.setattr(run, "run_case", broken)
  said = run.attempt(case, folder)
  assert "null_00" in said and "no minimum" in said
  assert ", in broken" in (folder / "null_00.error.txt").read_text()
  with pytest.raises(run.CaseFailed, match=r"1 case has no answer: null_00 .*no minimum"):
    run.all_answered(["", said], folder)
  monkeypatch.setattr(run, "run_case", lambda *_, **__: folder)
  assert run.attempt(case, folder) == ""
  assert not list(folder.glob("*.error.txt"))
  run.all_answered([""], folder)
