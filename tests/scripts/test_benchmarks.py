"""The commands that write the pages of results, in small."""

import dataclasses
import shutil

import pytest

from agents.control import tuning
from agents.control.controllers import entries
from agents.control.tuning import Tuned
from agents.learning import evaluate
from agents.studies import estimation_study, fault_report, fault_study, tracking_study
from agents.studies.filtering import learnt_bias, mismatch_study
from calibration.concealed.benchmarks.known import CARS
from calibration.concealed.proving_ground import make_session
from qcar_twin.paths import path_named
from qcar_twin.tracks import random_track
from scripts import benchmark_base, benchmark_estimation, benchmark_identification, campaign, tune
from tests import ROOT

ANSWERS = ROOT / "data" / "answers" / "1123581.jsonl.xz"  # six cases of a campaign of twelve
DRAWN = {"seed": 1123581, "nulls": 3, "singles": 6, "pairs": 2, "outside": 1, "design": "lab"}


def rows(text):
  return [line for line in text.splitlines() if line.startswith("| ") and line[2].isdigit()]


@pytest.mark.slow
def test_identification_of_two_cars_is_a_row_each(tmp_path, capsys):
  benchmark_identification.main(benchmark_identification.Config(tmp_path / "page.md", seed=501, quick=True))
  text = (tmp_path / "page.md").read_text(encoding="utf-8")
  assert [row.split("|")[1].strip() for row in rows(text)] == ["501", "502"] and text in capsys.readouterr().out
  for row in rows(text):
    longitudinal, lateral = (float(cell) for cell in row.split("|")[2:4])
    assert 0.0 < longitudinal < 5.0 and 0.0 < lateral < 10.0


@pytest.mark.slow
def test_estimation_without_a_real_car_says_so_on_its_page(tmp_path, monkeypatch):
  """On a turn to either side instead of a path, and for fourteen seconds around a fault that begins after six."""
  short = dataclasses.replace(random_track(39, 2.5), lanes=path_named("c").lanes)
  for study in (estimation_study, mismatch_study, tracking_study):
    monkeypatch.setattr(study, "path_named", lambda name: short)
  monkeypatch.setattr(evaluate, "path_from", lambda name: short)
  monkeypatch.setattr(learnt_bias, "BEGUN", 1.0)  # s
  for study in (fault_study, fault_report):
    monkeypatch.setattr(study, "SECONDS", 14.0)
  benchmark_estimation.main(benchmark_estimation.Config(tmp_path / "page.md", quick=True))
  text = (tmp_path / "page.md").read_text(encoding="utf-8")
  assert "`qcar-twin benchmark-estimation --quick`" in text and "Left out: run with `--dart DIR`." in text
  assert "nan" not in text and list((tmp_path / "page").glob("*.png"))
  assert "## The filter under faults" in text and "| encoder stuck |" in text
  before = text.split("## Cost")[0]
  benchmark_estimation.main(benchmark_estimation.Config(tmp_path / "page.md", quick=True, sections=("cost",)))
  again = (tmp_path / "page.md").read_text(encoding="utf-8")
  assert again.split("## Cost")[0] == before and "online, one car" in again.split("## Cost")[1]
  with pytest.raises(ValueError, match="no section speed; there are oval, mismatch, noise, states, recorded, faults"):
    benchmark_estimation.main(benchmark_estimation.Config(tmp_path / "page.md", quick=True, sections=("speed",)))


@pytest.mark.slow
def test_a_tuned_controller_joins_the_file_with_its_origin(tmp_path, capsys, monkeypatch):
  monkeypatch.setattr(tuning, "path_from", lambda name: random_track(1, 2.0))
  tune.main(tune.Config(tmp_path / "controllers.toml", controllers=("linear_rate",), quick=True))
  kept = entries(tmp_path / "controllers.toml")
  assert set(kept) == {"linear_rate"} and set(kept["linear_rate"]) == {"loose", "tuned"}
  assert kept["linear_rate"]["tuned"]["origin"].startswith("qcar-twin tune: S-path at 0.5 m/s")
  assert 0.0 < kept["linear_rate"]["tuned"]["rmse"] < 0.1
  said = capsys.readouterr()
  assert said.err == "stage 1 of 1 · tuning linear_rate\n" and said.out.startswith("linear_rate: RMSE ")


def test_tuning_says_how_long_it_still_takes(tmp_path, monkeypatch, capsys):
  shares = []

  def quickly(family, *given):
    given[-1](family.name, 0.5)
    shares.append(family.name)
    return Tuned({name: 1.0 for name in family.numbers}, 0.01, 0.1)

  monkeypatch.setattr(tune, "tune", quickly)
  tune.main(tune.Config(tmp_path / "controllers.toml", controllers=("ff_fb", "linear_rate")))
  first, second = capsys.readouterr().err.splitlines()
  assert first == "stage 1 of 2 · tuning ff_fb" and shares == ["ff_fb", "linear_rate"]
  assert second.startswith("stage 2 of 2 · tuning linear_rate · about ") and second.endswith(" left")


@pytest.fixture
def archive(tmp_path):
  return shutil.copy(ANSWERS, tmp_path / "answers.jsonl.xz")


def test_a_campaign_is_scored_from_its_archive(tmp_path, archive, capsys):
  config = campaign.Config(
    tmp_path / "scored", archive=tmp_path / "answers.jsonl.xz", page=tmp_path / "page.md", score_only=True, **DRAWN
  )
  table = campaign.main(config)
  assert (tmp_path / "scored" / "score.md").read_text() == table and table in capsys.readouterr().out
  assert len(list((tmp_path / "scored").glob("*_*.json"))) == 6
  text = (tmp_path / "page.md").read_text(encoding="utf-8")
  assert "`qcar-twin campaign --out out/scored --seed 1123581 --nulls 3 --singles 6" in text and "6 of 12" in text
  assert (tmp_path / "page.png").stat().st_size > 1000
  report = (tmp_path / "scored" / "report.html").read_text(encoding="utf-8")
  assert "6 of 12 sessions answered" in report and "Confusion matrix" in report


def test_a_campaign_goes_on_with_the_cases_that_have_no_answer(tmp_path, archive, monkeypatch):
  asked = []
  monkeypatch.setattr(campaign, "attempt", lambda case, folder, engine: asked.append(case.name) or "")
  config = campaign.Config(tmp_path / "out", archive=tmp_path / "answers.jsonl.xz", jobs=1, **DRAWN)
  campaign.main(config)
  answered = {path.stem for path in (tmp_path / "out").glob("*_*.json")}
  assert len(answered) == 6 and len(asked) == 6 and not answered & set(asked)


def test_a_campaign_of_the_second_car_asks_for_its_cases(tmp_path, monkeypatch):
  asked = []
  monkeypatch.setattr(campaign, "attempt", lambda case, folder, engine: asked.append(case) or "")
  campaign.main(campaign.Config(tmp_path / "out", seed=3, nulls=2, singles=3, jobs=1, car="second"))
  assert sorted(case.kind for case in asked) == ["null"] * 2 + ["single"] * 3
  assert {case.car for case in asked} == {"second"}


@pytest.mark.slow
def test_the_base_of_a_session_without_an_effect_is_a_row(tmp_path, capsys, monkeypatch):
  """On every sixth recording that is fitted: a poor start takes as long again as the fit."""

  def short(seed):
    session = make_session(seed, (), "compact")
    fitted = [r for r in session.recordings if r.role == "identify"]
    return dataclasses.replace(session, recordings=tuple(fitted[::6]))

  monkeypatch.setitem(CARS, "first", short)
  text = benchmark_base.main(benchmark_base.Config(tmp_path / "page.md", seed=41900, quick=True))
  assert (tmp_path / "page.md").read_text(encoding="utf-8") == text and text in capsys.readouterr().out
  (row,) = (line for line in text.splitlines() if line.startswith("| first "))
  seed, errors, inside, starts = (cell.strip() for cell in row.split("|")[1:5])
  assert seed == "first 41900" and starts in ("0 of 1", "1 of 1") and inside.endswith(" of 8")
  mass = next(float(part.split()[1]) for part in errors.split(", ") if part.startswith("mass "))
  assert abs(mass) < 10.0  # per cent; it was weighed
