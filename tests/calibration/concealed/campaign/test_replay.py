"""Kept evidence decided again: counted as a campaign counts, rule by rule, from answers, archives and exams."""

import dataclasses
import json
import shutil

import pytest

from calibration.concealed.campaign.archive import digest, pack
from calibration.concealed.campaign.replay import kept_cases, replayed, table
from calibration.concealed.examination.kept import kept_in, write_kept
from calibration.diagnosis.decision.evidence import as_json
from calibration.diagnosis.decision.levels import FILE, usual_levels
from calibration.diagnosis.search.gather import gather
from scripts import replay

NOTHING = dataclasses.replace(usual_levels(), claim=1.0)  # a rule that claims nothing


@pytest.fixture(scope="module")
def results(pair_pool, clean_pool):
  """A case without an effect, one with two, one of an exam, and one that is older than evidence."""
  both = [{"id": "steering_offset", "in_catalogue": True}, {"id": "side_force", "in_catalogue": True}]
  case = lambda kind, pool, truth: answered(f"{kind}_00", kind, gather(pool), truth)
  old = {"case": {"name": "null_01", "kind": "null"}, "answer": {}, "truth": []}
  exam = {"name": "case_000", "truth": {"kind": "outside", "effects": [{"right": []}], "car": {"generator": "slipx"}}}
  exam["answer"] = {"evidence": as_json(gather(clean_pool))}
  return [case("null", clean_pool, []), case("pair", pair_pool, both), old, exam]


def answered(name, kind, evidence, truth):
  answer = {"evidence": as_json(evidence)}
  return {"case": {"name": name, "kind": kind}, "answer": answer, "sha256": digest(answer), "truth": truth}


def test_cases_are_read_with_their_truth_and_those_without_evidence_are_left_out(results):
  null, pair, outside = kept_cases(results)
  assert (null.kind, null.effects) == ("null", ()) and (outside.kind, outside.right) == ("outside", frozenset())
  assert (null.generator, outside.generator) == ("first", "slipx")
  assert pair.right == {"steering_offset", "side_force"} and len(pair.effects) == 2
  assert {c.mechanism for c in replayed(pair, usual_levels()).claims} == pair.right


def test_rules_are_counted_side_by_side_and_where_they_differ_is_listed(results):
  said = table(list(kept_cases(results)), {"usual": usual_levels(), "nothing": NOTHING})
  assert "| without an effect: something claimed | 0 of 1 | 0 of 1 |" in said
  assert "| two effects: both named | 1 of 1 | 0 of 1 |" in said
  assert "| two effects: nothing false | 1 of 1 | 1 of 1 |" in said
  assert "| pair_00 | pair | steering_offset + side_force |" in said and "null_00" not in said
  assert "pair_00" not in table(list(kept_cases(results)), {"usual": usual_levels()})


def test_a_folder_and_its_archive_are_replayed_alike(results, tmp_path):
  for result in results[:2]:
    (tmp_path / f"{result['case']['name']}.json").write_text(json.dumps(result))
  archive = tmp_path / "kept.jsonl.xz"
  pack(tmp_path, archive)
  told = [replay.main(replay.Config((source,))) for source in (tmp_path, archive)]
  assert told[0] == told[1] and "| counted | levels |" in told[0]


def test_files_of_one_name_are_told_apart(results, tmp_path):
  write_kept(tmp_path / "evidence.jsonl.xz", list(kept_cases(results)))
  other = tmp_path / "levels.toml"
  shutil.copy(FILE, other)
  said = replay.main(replay.Config((tmp_path / "evidence.jsonl.xz",), (FILE, other)))
  assert f"| counted | {FILE} | {other} |" in said


def test_answers_without_evidence_are_refused(tmp_path):
  (tmp_path / "null_00.json").write_text(json.dumps({"case": {}, "answer": {}, "truth": []}))
  with pytest.raises(ValueError, match="run the campaign again"):
    replay.main(replay.Config((tmp_path,), (FILE,)))


def test_evidence_that_is_kept_in_one_archive_is_that_of_the_cases(results, tmp_path):
  cases = list(kept_cases(results))
  write_kept(tmp_path / "evidence.jsonl.xz", cases)
  assert kept_in([tmp_path / "evidence.jsonl.xz"]) == cases


def test_a_rule_with_another_of_the_numbers_evidence_was_gathered_with_is_refused(results):
  """It would change nothing, and two columns alike would say that the number does not matter."""
  other = dataclasses.replace(usual_levels(), cap=1.0)
  with pytest.raises(ValueError, match="rule 'other' has cap = 1, but kept evidence was gathered with 10"):
    table(list(kept_cases(results)), {"usual": usual_levels(), "other": other})
