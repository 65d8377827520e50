"""Truths stay shut until all is answered, and what was sealed or answered cannot be changed unnoticed."""

import json

import pytest

from calibration.concealed.examination.sealed import Plan, begin, close, keep_answer, lock, opened, read_plan
from calibration.concealed.laboratory.seal import SealError

PLAN = Plan("slipx", "c0ffee", True, 2)
TRUTHS = {"case_000": {"kind": "null", "effects": []}, "case_001": {"kind": "single", "effects": [{"id": "drag"}]}}


@pytest.fixture
def folder(tmp_path):
  begin(tmp_path, PLAN)
  for name, truth in TRUTHS.items():
    lock(tmp_path, name, truth)
  return tmp_path


def answer_all(folder):
  for name in TRUTHS:
    keep_answer(folder, name, {"verdict": "explained", "claims": [{"probability": 0.1 + 0.2}], "set": ("a",)})


def test_truths_cannot_be_read_before_all_is_answered(folder):
  with pytest.raises(SealError, match="stay sealed"):
    opened(folder)
  keep_answer(folder, "case_000", {"verdict": "explained"})
  with pytest.raises(SealError, match="1 of 2 cases have no answer"):
    close(folder, list(TRUTHS))
  written = "".join(path.read_text() for path in folder.rglob("*") if path.is_file())
  assert "drag" not in written and "kind" not in written
  assert read_plan(folder).key == "" and (folder / "key").stat().st_mode & 0o077 == 0


def test_once_all_is_answered_they_open(folder):
  answer_all(folder)
  plan = close(folder, list(TRUTHS))
  assert {r["name"]: r["truth"] for r in opened(folder)} == TRUTHS
  assert plan == close(folder, []) and plan.key and plan.closed == tuple(TRUTHS)


def test_an_exam_may_be_closed_with_what_is_answered_but_not_with_nothing(folder):
  with pytest.raises(SealError):
    close(folder, list(TRUTHS), early=True)
  keep_answer(folder, "case_001", {"verdict": "explained"})
  close(folder, list(TRUTHS), early=True)
  assert [r["name"] for r in opened(folder)] == ["case_001"]


@pytest.mark.parametrize("what", ["answers/case_001.json", "truths/case_001.sealed"])
def test_a_change_is_noticed(folder, what):
  answer_all(folder)
  close(folder, list(TRUTHS))
  path = folder / what
  content = json.loads(path.read_text())
  if "answer" in content:
    content["answer"]["verdict"] = "no_mismatch"
  else:
    content["enciphered"] = content["enciphered"][:-1] + ("0" if content["enciphered"][-1] != "0" else "1")
  path.write_text(json.dumps(content))
  with pytest.raises(SealError, match="counts no more"):
    opened(folder)


def test_no_answer_goes_before_its_truth_and_no_truth_is_replaced(folder):
  with pytest.raises(SealError, match="after its truth was sealed"):
    keep_answer(folder, "case_002", {})
  assert lock(folder, "case_000", TRUTHS["case_000"]) == lock(folder, "case_000", TRUTHS["case_000"])
  with pytest.raises(SealError, match="another truth"):
    lock(folder, "case_000", TRUTHS["case_001"])


def test_another_exam_does_not_go_on_in_the_folder(folder):
  assert begin(folder, PLAN) == PLAN
  with pytest.raises(SealError, match="begun with commit c0ffee"):
    begin(folder, Plan("slipx", "decaf", True, 2))
