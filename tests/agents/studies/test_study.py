"""The study: jobs that are done once, trainings that go on, drives kept whole, and what the page makes of them."""

import dataclasses
import json

import numpy as np
import pytest

from agents.control.kpis import Kpis
from agents.learning.evaluate import EvaluationCase, Row
from agents.learning.policy_file import save_policy
from agents.studies import study
from agents.studies.study import (
  CONTROLLERS,
  VARIANTS,
  Setting,
  driving_jobs,
  read_rows,
  settings,
  training_jobs,
  warm_start,
)
from agents.studies.study_report import MARGINS, change, driven, floor_section, margin_section, page, repair_section
from tests.agents.learning.test_train import GOOD, PLAN

CASE = EvaluationCase("s", "bicycle", cars=2, estimator="truth")


def kpis_of(rmse, me=None, iaca=0.2, inside=True):
  values = np.asarray(rmse, dtype=float)
  one = np.ones(len(values))
  ok = np.isfinite(values)
  me = 2.0 * values if me is None else me * one
  return Kpis(me, values, iaca * one, one, ok, ok & inside)


def finished(folder, variant, seed, policy=GOOD, **result):
  """A training that is over."""
  target = folder / variant / f"seed{seed}"
  save_policy(policy, target / "best")
  seconds = {"total": 100.0, "cpu": 60.0, "learning": 50.0, "evaluation": 5.0}
  table = {"episodes": 300, "seconds": seconds, "best_episode": 90, "best_rmse_training_path": 0.007}
  table |= {"ten_full_episodes_in_a_row_at": None} | result
  (target / "result.json").write_text(json.dumps(table))


def evaluated(folder, setting, rows, name="all"):
  target = folder / "evaluated" / setting
  target.mkdir(parents=True, exist_ok=True)
  (target / f"{name}.json").write_text(json.dumps([row.as_json() for row in rows]))


# -- jobs ----------------------------------------------------------------------------------------


def test_every_seed_is_a_job_with_its_own_plan(tmp_path, monkeypatch):
  asked = []
  monkeypatch.setattr(study, "warm_start", lambda plan, target: asked.append((plan, target)))
  for job in training_jobs(tmp_path, "standard", (0, 3), episodes=40):
    job.work()
  assert [plan.seed for plan, _ in asked] == [0, 3] and {plan.settings.episodes for plan, _ in asked} == {40}
  assert [target.name for _, target in asked] == ["seed0", "seed3"]
  training_jobs(tmp_path, "wide", (0,), episodes=40)[0].work()
  assert asked[-1][0].settings.episodes == 0 and asked[-1][0].settings.imitations > 0


def test_an_agent_of_a_twin_waits_for_it(tmp_path, monkeypatch):
  assert training_jobs(tmp_path, "repaired", (0,)) == []
  (tmp_path / "repaired.toml").write_text("")
  asked = []
  monkeypatch.setattr(study, "warm_start", lambda plan, target: asked.append(plan.options.twin))
  training_jobs(tmp_path, "repaired", (0,))[0].work()
  assert asked == [str(tmp_path / "repaired.toml")]


def test_variants_differ_in_what_they_say():
  standard, alone, wide = (VARIANTS[name].plan for name in ("standard", "alone", "wide"))
  assert standard.options.demonstrator == "lq_ed" and standard.options.reward.m6 > 0.0
  assert alone.options.demonstrator == "" and alone.options.reward.m6 == 0.0
  assert dataclasses.replace(alone, options=standard.options) == standard
  assert wide.observation.size == 9 and wide.options.gain_spread > 0.0
  assert all(v.plan.options.path == "s" and v.plan.options.steering_gain == 1.0 for v in VARIANTS.values())


def test_a_training_is_taken_up_where_it_was_and_a_broken_one_begun_anew(tmp_path):
  plan = dataclasses.replace(PLAN, settings=dataclasses.replace(PLAN.settings, episodes=4))
  tmp_path.joinpath("training.json").write_text("{}")  # killed before its first checkpoint
  assert warm_start(plan, tmp_path)["resumed"] == 0
  assert warm_start(plan, tmp_path)["resumed"] == 1


def test_drives_are_of_everybody_that_is_trained_and_replace_older_ones(tmp_path):
  setting = Setting((CASE,), (CONTROLLERS, "standard", "alone"))
  finished(tmp_path, "standard", 0)
  first = driving_jobs(tmp_path, "N", setting)
  assert [job.name for job in first] == ["drive N controllers", "drive N standard"]
  for job in first:
    job.work()
    assert job.file.is_file()
  finished(tmp_path, "standard", 4)
  second = driving_jobs(tmp_path, "N", setting)[1]
  assert not second.file.is_file()
  second.work()
  assert {f.name for f in second.file.parent.iterdir()} == {"controllers.json", "standard 0 4.json"}
  rows = read_rows(second.file)
  assert [row.contestant for row in rows] == ["standard 0", "standard 4"] and rows[0].case == CASE
  np.testing.assert_array_equal(rows[0].kpis.rmse, rows[1].kpis.rmse)
  (entry,) = [e for e in driven(tmp_path, "N") if e["contestant"] == "standard"]
  assert entry["trainings"] == 2 and len([e for e in driven(tmp_path, "N")]) == 5


def test_a_run_that_left_the_path_comes_back_as_infinite(tmp_path):
  evaluated(tmp_path, "N", [Row("wide 0", CASE, kpis_of([0.004, np.inf]))])
  (row,) = read_rows(tmp_path / "evaluated" / "N" / "all.json")
  assert row.kpis.rmse[0] == 0.004 and np.isinf(row.kpis.rmse[1]) and not row.kpis.finished[1]


def test_settings_cover_what_the_page_compares():
  known = settings(8, (0.3, 1.2), ("bicycle", "pg", "pg x=1"), ("own", "own x=1"))
  assert list(known) == ["N", "MIS", "0.3 m/s", "1.2 m/s", "bicycle", "pg", "pg x=1", "own", "own x=1"]
  assert {c.path for c in known["N"].cases} == {"o", "infinity", "c"} and known["N"].versions == ("loose", "tuned")
  assert {(c.steering_gain, c.steering_offset) for c in known["MIS"].cases} == {(0.92, 1.0)}
  assert {c.speed for c in known["1.2 m/s"].cases} == {1.2}
  assert "repaired" in known["own x=1"].groups and "repaired" not in known["pg"].groups


# -- the page ------------------------------------------------------------------------------------


def everybody(scale=1.0):
  """Rows of a fictitious study: the standard agent twice as good as LQ_ed loose, a tenth worse than the floor."""
  sizes = {"linear_rate tuned": 0.010, "lq_cm tuned": 0.020, "lq_ed loose": 0.022, "ff_fb loose": 0.088}
  sizes |= {"standard 0": 0.0105, "standard 1": 0.0115, "wide 0": 0.005}
  return [
    Row(name, EvaluationCase(path, cars=2), kpis_of([scale * rmse] * 2))
    for name, rmse in sizes.items()
    for path in study.PATHS
  ]


def test_margins_are_of_medians_and_say_when_they_are_reached(tmp_path):
  evaluated(tmp_path, "N", everybody())
  table = driven(tmp_path, "N")
  assert change(table, "standard", "lq_ed loose", "infinity", "rmse") == pytest.approx(-50.0)
  assert change(table, "standard", "nobody", "c", "rmse") is None
  lines = margin_section(table, table, ["standard", "wide"])
  row = next(line for line in lines if "| infinity | lq_cm tuned | RMSE" in line)
  assert "-45 % (reached)" in row and "-75 % (reached)" in row
  row = next(line for line in lines if "| infinity | lq_ed loose | RMSE" in line)
  assert "| -50 % |" in row and "-77 % (reached)" in row
  assert len(lines) == 2 + len(MARGINS)
  assert "| standard | +10 % | +10 % | +10 % |" in floor_section(table, table, ["standard"])[2]


def test_the_gap_closed_is_what_retraining_on_the_repaired_twin_gains(tmp_path):
  cases = {"wide 0": 0.010, "recalibrated 0": 0.014, "repaired 0": 0.008}
  rows = [
    Row(name, EvaluationCase(p, cars=2), kpis_of([rmse] * 2)) for name, rmse in cases.items() for p in study.PATHS
  ]
  evaluated(tmp_path, "with", rows)
  evaluated(tmp_path, "without", [Row("wide 0", EvaluationCase(p, cars=2), kpis_of([0.006] * 2)) for p in study.PATHS])
  lines = repair_section(tmp_path, "without", "with")
  assert lines[2].endswith("| 75 % |") and "14.0 [14.0, 14.0]" in lines[2]


def test_page_tells_what_is_there(tmp_path):
  folder, file = tmp_path / "study", tmp_path / "page.md"
  for seed in (0, 1):
    finished(folder, "standard", seed)
    table = "episode,rmse,me,iaca,finished,seconds\n15,0.02,0.1,0.2,1,3\n30,0.01,0.05,0.2,1,6\n"
    (folder / "standard" / f"seed{seed}" / "evaluations.csv").write_text(table)
  for setting in ("N", "MIS", "0.3 m per s", "bicycle"):
    evaluated(folder, setting, everybody())
  (folder / "timings.json").write_text(json.dumps(["a step takes 1 us"]))
  (tmp_path / "page").mkdir()
  (tmp_path / "page" / "notes.md").write_text("Read this first.\n")
  text = page(folder, file)
  for expected in ("Read this first", "a step takes 1 us", "| standard | 2 | 300 |", "0.3 m/s", "bicycle", "+10 %"):
    assert expected in text
  assert text.index("Read this first") < text.index("## Trainings")
  names = {p.name for p in (tmp_path / "page").iterdir()}
  assert names == {"learning.png", "indicators_N.png", "indicators_MIS.png", "notes.md"}


def test_page_of_an_empty_folder_is_a_page(tmp_path):
  assert page(tmp_path, tmp_path / "page.md").startswith("# Results")
