"""The commands behind the results of learning."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from agents.learning.train import Plan
from agents.studies import comparison, concealed_cars, study, study_report
from agents.studies import robustness as robustness_study
from agents.studies.filtering import acceptance_study
from agents.studies.robustness import circumstances
from agents.studies.study import VARIANTS, Variant
from calibration.concealed.campaign.run import CaseFailed
from qcar_twin import tracks
from scripts import benchmark_filter, benchmark_learning, compare, concealed_agents, robustness
from scripts import study as study_command
from tests.agents.learning.test_train import PLAN
from tests.agents.studies.test_study import CASE

SHORT = ("random:1:2", "random:2:2", "random:3:2")  # 2 m each, at most a turn more; a course of the results has 5 to 15


@pytest.mark.slow
def test_script_does_a_limited_number_of_jobs_and_goes_on(tmp_path, monkeypatch, capsys):
  options, settings = dataclasses.replace(PLAN.options, path=SHORT[0]), dataclasses.replace(PLAN.settings, episodes=4)
  small = dataclasses.replace(PLAN, options=options, settings=settings)
  assert isinstance(small, Plan)
  monkeypatch.setitem(VARIANTS, "standard", Variant("small", small))
  monkeypatch.setattr(study, "_cases", lambda *_, **__: (dataclasses.replace(CASE, path=SHORT[0]),))
  config = study_command.Config(tmp_path / "out", variants=("standard",), quick=True, limit=1)
  study_command.main(config)
  assert (tmp_path / "out" / "standard" / "seed0" / "result.json").is_file()
  assert not (tmp_path / "out" / "evaluated").exists()
  left = study_command.main(dataclasses.replace(config, limit=0, page=tmp_path / "page.md"))
  said = capsys.readouterr()
  assert left == 0 and "jobs left" in said.out
  lines = said.err.splitlines()
  assert lines[0] == "stage 1 of 1 · train standard 0", "the limit is the plan"
  assert all(re.fullmatch(r"stage \d of \d · drive \w+ \w+( · about \d+ (s|min) left)?", line) for line in lines[1:])
  assert len(lines) == 5 and sum(line.endswith(" left") for line in lines) == 3
  assert "| standard | 1 |" in (tmp_path / "page.md").read_text()


def test_script_knows_the_independent_car_by_name():
  start = np.array([[0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0]])
  ends = []
  for name in ("proving ground", "proving ground steering_offset=1", "proving ground car=3 steering_offset=1"):
    plant, theta = study_command.plant(name)
    simulation = plant.begin(theta, start)
    for _ in range(60):
      signals = simulation.step(np.array([[0.8, 0.0]]))
    ends.append(signals[0, 2])
  assert abs(ends[0]) < 0.01 < abs(ends[1]) and ends[2] not in ends[:2]
  concealed = study_command.Config(Path("x"), car=3, concealed="steering_offset=1").special
  assert concealed == ("proving ground car=3", "proving ground car=3 steering_offset=1")
  assert study_report.FLOOR == "linear_rate tuned"


def test_script_writes_a_sentence_per_measurement(tmp_path, monkeypatch, capsys):
  monkeypatch.setattr(benchmark_learning, "steps_per_second", lambda *_: 1000.0)
  monkeypatch.setattr(benchmark_learning, "FLEETS", (1, 8))
  sentences = benchmark_learning.main(benchmark_learning.Config(tmp_path / "timings.json", steps=800, quick=True))
  assert json.loads((tmp_path / "timings.json").read_text()) == sentences
  assert any("1000.0 us per 10 ms" in line for line in sentences) and "gradient steps" in capsys.readouterr().out


@pytest.mark.slow
def test_compare_writes_paired_differences_with_their_intervals(tmp_path, capsys, monkeypatch):
  monkeypatch.setattr(comparison, "PATHS", SHORT[:1])
  monkeypatch.setattr(tracks, "LENGTH", 2.0)  # m, of the random tracks
  compare.main(compare.Config(tmp_path / "out", names=("linear_rate",), quick=True))
  table = (tmp_path / "out" / "comparison.md").read_text(encoding="utf-8")
  assert table.strip() in capsys.readouterr().out and "linear_rate" in table
  before = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
  monkeypatch.setattr(comparison, "run_together", None)  # nothing is driven twice
  compare.main(compare.Config(tmp_path / "out", names=("linear_rate",), quick=True))
  assert json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8")) == before
  with pytest.raises(TypeError, match="not callable"):
    compare.main(compare.Config(tmp_path / "out", names=("linear_rate",), streams=3, tracks=0))


@pytest.mark.slow
def test_robustness_writes_what_changes_with_the_circumstances(tmp_path, capsys, monkeypatch):
  monkeypatch.setattr(robustness_study, "PATHS", SHORT)
  robustness.main(robustness.Config(tmp_path / "out", names=("linear_rate",), quick=True))
  table = (tmp_path / "out" / "robustness.md").read_text(encoding="utf-8")
  assert table.strip() in capsys.readouterr().out and "filter noise x 2" in table and "linear_rate" in table
  stored = json.loads((tmp_path / "out" / "robustness.json").read_text(encoding="utf-8"))
  nominal, noisy = (np.array(stored[name]["rmse"]["ppo"]) for name in ("nominal, 0.5 m/s", "filter noise x 2"))
  assert nominal.shape == noisy.shape == (2, 3) and np.all(nominal != noisy)


def test_circumstances_lie_inside_and_outside_of_what_the_agents_were_trained_on():
  made = circumstances()
  for name, changes in made.items():
    if "linkage" in name:
      share = np.hypot((changes["steering_gain"] - 1.0) / 0.1, changes["steering_offset"] / 1.5)
      assert share == pytest.approx(0.8 if "inside" in name else 1.6, abs=0.02)
  assert sum("inside" in name for name in made) == sum("outside" in name for name in made) == 5


@pytest.mark.slow
def test_what_the_filter_gets_through_is_a_page(tmp_path, monkeypatch):
  monkeypatch.setattr(acceptance_study, "LIMIT_SECONDS", 4.0)  # the step steer comes after 2 s
  monkeypatch.setattr(acceptance_study, "WEAVE_SECONDS", 4.0)  # without a fault, which would begin at 6 s
  benchmark_filter.main(benchmark_filter.Config(tmp_path / "filter.md", cars=("twin",), quick=True))
  page = (tmp_path / "filter.md").read_text(encoding="utf-8")
  rows = [line.split("|") for line in page.splitlines() if "| twin |" in line]
  assert len(rows) >= 3 and all(row[-2].strip().startswith("0 of") for row in rows)


def test_concealed_agents_drive_every_car_once_and_go_on(tmp_path, monkeypatch):
  """Each car is diagnosed, then driven by what was trained once and by what was trained for it; one that cannot be is
  named, costs the others nothing and is tried again."""
  asked, trained, broken = [], [], {"second_00"}

  def train(hyper, changes, seed, folder):
    trained.append((folder.parent.name, seed))
    return folder

  def diagnosed(case, folder, effort):
    if case.name in broken:
      raise OSError("no space left")
    folder.mkdir(parents=True)
    (folder / concealed_agents.VERDICT).write_text("no_mismatch")

  def driven(policies, folder, plants, streams, controllers, file):
    asked.append((folder.name, set(policies), set(plants), streams))
    competitors = (*policies, *controllers, *concealed_cars.ABOUT, concealed_cars.REFERENCE)
    file.write_text(json.dumps({name: [[[1e-3, 2e-3]] * 3] for name in competitors}))

  monkeypatch.setattr(concealed_cars, "train_agent", train)
  monkeypatch.setattr(concealed_cars, "own_options", lambda folder: {n: {"twin": n} for n in concealed_cars.OWN})
  monkeypatch.setattr(concealed_agents, "diagnosed", diagnosed)
  monkeypatch.setattr(concealed_agents, "drive_car", driven)
  options = concealed_agents.Config(tmp_path, first=1, second=1, quick=True, seeds_once=(0, 1))
  with pytest.raises(CaseFailed, match="second_00 .*no space left"):
    concealed_agents.main(options)
  assert [name for name, *_ in asked] == ["first_00"] and "first_00" in (tmp_path / "cars.md").read_text()
  assert [(name, s) for name in concealed_cars.ONCE for s in (0, 1)] == trained[:6]
  own = {seed for name, seed in trained[6:]}
  assert len(own) == 1 and [name for name, _ in trained[6:]] == list(concealed_cars.OWN)
  broken.clear()
  table = concealed_agents.main(options)
  assert [name for name, *_ in asked] == ["first_00", "second_00"] and trained[-1][1] not in own
  assert all(
    {*concealed_cars.ONCE, *concealed_cars.OWN} == policies and streams == 2 for _, policies, _, streams in asked
  )
  assert (tmp_path / "cars.md").read_text() == table and "no_mismatch" in table
  before = len(trained)
  assert concealed_agents.main(dataclasses.replace(options, first=3, score_only=True)) == table
  assert len(trained) == before and not list(tmp_path.glob("*.error.txt"))
