"""The command: it refuses changed files, goes on where it was, and opens nothing while a case has no answer."""

import functools
import subprocess

import pytest

from calibration.concealed.campaign.run import CaseFailed
from calibration.concealed.exam.slipx_car import SlipxCar
from calibration.concealed.examination import run
from calibration.concealed.examination.commit import NotCommitted, code_of, committed
from calibration.concealed.examination.sealed import read_plan
from calibration.diagnosis.pipeline import diagnose
from calibration.diagnosis.search.structure import Effort
from scripts import exam

ANSWER = {"verdict": "no_mismatch", "claims": [], "scored": []}


@pytest.fixture
def quick(monkeypatch):
  """Cases that are made and answered at once; returns the names of those that were."""
  made = []

  def sit(case, folder):
    if case.name == "case_001" and made == ["case_000"]:
      made.append("case_001 failed")
      raise RuntimeError("power cut")
    made.append(case.name)
    run.lock(folder, case.name, {"kind": case.kind, "effects": []})
    run.keep_answer(folder, case.name, ANSWER)

  monkeypatch.setattr(run, "sit", sit)
  return made


def test_an_exam_that_was_stopped_goes_on_with_what_is_missing(tmp_path, quick, capsys):
  config = exam.Config(tmp_path / "exam", cases=3, unsealed=True)
  with pytest.raises(CaseFailed, match="case_001"):
    exam.main(config)
  assert not read_plan(config.out).closed and "key of the truths" not in capsys.readouterr().out
  report = exam.main(config)
  assert quick == ["case_000", "case_001 failed", "case_002", "case_001"]
  assert report.is_file() and read_plan(config.out).key in capsys.readouterr().out
  exam.main(config)
  assert len(quick) == 4, "a closed exam is only scored"
  page = (config.out / "exam.md").read_text()
  assert "`qcar-twin exam --generator slipx --cases 3 --unsealed --trial trial --out out/exam`" in page


def test_changed_files_are_refused(tmp_path):
  git = lambda *words: subprocess.run(["git", "-C", str(tmp_path), *words], check=True, capture_output=True)
  with pytest.raises(NotCommitted, match="no checkout"):
    committed(tmp_path)
  assert code_of(tmp_path) == ""
  git("init", "-q")
  (tmp_path / "a.py").write_text("a = 1\n")
  with pytest.raises(NotCommitted, match=r"a\.py"):
    committed(tmp_path)
  git("add", "a.py")
  git("-c", "user.name=x", "-c", "user.email=x@y", "commit", "-qm", "a")
  assert len(committed(tmp_path)) == 40 and code_of(tmp_path) == committed(tmp_path)[:12]
  (tmp_path / "a.py").write_text("a = 2\n")
  assert code_of(tmp_path).endswith(" with changed files")


@pytest.mark.slow
def test_one_case_of_slipx_is_made_sealed_and_answered(tmp_path, monkeypatch):
  """Every third run, and a narrow search; what a whole one finds, the results show."""
  pytest.importorskip("slipx", reason="slipx is not installed (extra `exam`)")
  whole = SlipxCar.runs
  monkeypatch.setattr(SlipxCar, "runs", lambda car, rng: whole(car, rng)[::3])
  narrow = {"candidates": ("steering_delay", "gyro_scale"), "effort": Effort(1, 0, 0, 1)}
  monkeypatch.setattr(run, "diagnose", functools.partial(diagnose, **narrow))
  report = exam.main(exam.Config(tmp_path / "exam", cases=1, unsealed=True))
  text = (tmp_path / "exam" / "exam.md").read_text()
  assert report.is_file() and "1 of 1 cases answered" in text and "a trial that was not sealed" in text
