"""Training as a whole, short: files, a kill in the middle, resuming, the best agent, clear errors."""

import csv
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from agents.control.kpis import Kpis
from agents.control.model import Model
from agents.learning import train as training
from agents.learning.ddpg import Settings
from agents.learning.environments import Options
from agents.learning.policy_file import Policy, load_policy, onnx_difference
from agents.learning.train import Plan, Progress, judge, train
from qcar_twin.envs.task import Reward
from scripts.__main__ import main
from tests import ROOT

SHORT = "random:1:2"  # 3 m, a turn between straights
OPTIONS = Options(SHORT, 1.0, plant="bicycle", estimator="truth", version="tuned")
PLAN = Plan(OPTIONS, Settings(episodes=8, cars=4, warm_up=100, steps_per_update=16), every=4, progress_bar=False)


def rows(file):
  with open(file, newline="", encoding="utf-8") as stream:
    return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
  folder = tmp_path_factory.mktemp("training") / "run"
  return folder, train(PLAN, folder)


def test_a_training_leaves_everything_it_should(trained):
  folder, result = trained
  names = {p.name for p in folder.iterdir()}
  assert {"training.json", "episodes.csv", "evaluations.csv", "tensorboard", "best", "last", "result.json"} <= names
  assert json.loads((folder / "result.json").read_text()) == result
  episodes = rows(folder / "episodes.csv")
  assert [row["episode"] for row in episodes] == list(range(1, 9)) and result["episodes"] == 8
  assert result["updates"] == pytest.approx((result["steps"] - 100) / 16, abs=30)
  assert np.all(np.diff([row["seconds"] for row in episodes]) >= 0.0)
  assert list((folder / "tensorboard").glob("events*"))
  assert set(result["seconds"]) == {"total", "cpu", "learning", "evaluation"}


def test_what_was_asked_for_is_kept_word_for_word(trained):
  table = json.loads((trained[0] / "training.json").read_text())
  assert Plan.from_json(table) == PLAN
  assert load_policy(trained[0] / "last").provenance["training"]["settings"]["episodes"] == 8


def test_the_kept_policy_is_exported_and_acts_the_same(trained):
  policy = load_policy(trained[0] / "best")
  assert onnx_difference(policy, trained[0] / "best" / "policy.onnx") < 1e-5
  assert trained[1]["onnx_difference"] < 1e-5


def test_the_same_seed_trains_the_same_agent(trained, tmp_path):
  train(PLAN, tmp_path / "again")
  first, again = load_policy(trained[0] / "last"), load_policy(tmp_path / "again" / "last")
  for (a, _), (b, _) in zip(first.layers, again.layers, strict=True):
    np.testing.assert_array_equal(a, b)


def test_a_folder_with_a_training_is_not_overwritten(trained):
  with pytest.raises(FileExistsError, match="--resume"):
    train(PLAN, trained[0])


def test_a_finished_training_is_not_trained_further_by_resuming(trained):
  before = load_policy(trained[0] / "last")
  result = train(PLAN, trained[0], resume=True)
  assert result["episodes"] == 8 and result["resumed"] == 1
  np.testing.assert_array_equal(load_policy(trained[0] / "last").layers[1][0], before.layers[1][0])


def test_nothing_to_resume_is_said(tmp_path):
  with pytest.raises(FileNotFoundError, match="no checkpoint"):
    train(PLAN, tmp_path / "empty", resume=True)


def test_killed_in_the_middle_and_resumed_nothing_before_the_checkpoint_is_lost(tmp_path):
  folder, straight = tmp_path / "run", tmp_path / "straight.csv"
  straight.write_text("".join(f"{0.1 * k:.1f},0\n" for k in range(11)), encoding="utf-8")  # 1 m: the episodes are short
  command = [sys.executable, "-m", "scripts", "train", "--out", str(folder), "--quick", "--seed", "3"]
  command += ["--episodes", "20", "--path", str(straight)]
  environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
  first = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
  deadline = time.monotonic() + 120.0
  while not (folder / "checkpoint.json").exists() and time.monotonic() < deadline:
    time.sleep(0.005)
  first.send_signal(signal.SIGKILL)
  assert first.wait() == -signal.SIGKILL, "the training was over before it could be killed"
  kept = json.loads((folder / "checkpoint.json").read_text())
  saved = kept["progress"]["episodes"]
  assert 4 <= len(saved) < 20 and not (folder / "result.json").exists()
  with open(folder / "episodes.csv", "a", encoding="utf-8") as stream:
    stream.write("99,1,")  # a line the kill cut off
  assert main([*command[3:], "--resume"]) == 0
  episodes = rows(folder / "episodes.csv")
  assert [row["episode"] for row in episodes] == list(range(1, 21))
  np.testing.assert_allclose([list(row.values()) for row in episodes[: len(saved)]], saved, rtol=1e-5)
  assert np.all(np.diff([row["steps"] for row in episodes]) >= 0.0)
  result = json.loads((folder / "result.json").read_text())
  assert result["resumed"] == 1 and result["episodes"] == 20 and result["steps"] > kept["num_timesteps"]
  assert result["updates"] > kept["updates"]
  load_policy(folder / "best")


def test_plan_survives_json_with_every_field_changed():
  options = Options(
    "o", 0.7, 2, "reduced", "x.toml", 5, "truth", "lq_cm", "tuned", 0.92, 1.0, 0.05, 0.01, "prior", 0.02
  )
  options = dataclasses.replace(options, reward=Reward(*np.arange(1.0, 8.0).tolist(), near=0.01, aligned=0.1))
  settings = Settings(observation_scale=(1.0, 2.0, 3.0, 4.0), demonstrations=5)
  plan = Plan(options, settings, seed=4, every=3, judges=2, progress_bar=False)
  assert Plan.from_json(json.loads(json.dumps(plan.as_json()))) == plan


# -- the best ------------------------------------------------------------------------------------

GOOD = Policy(
  (
    (np.array([[-1.5, -1.3, -1.0, -1.0], [1.5, 1.3, 1.0, 1.0]], np.float32), np.zeros(2, np.float32)),
    (np.eye(2, dtype=np.float32), np.zeros(2, np.float32)),
    (np.array([[1.0, -1.0]], np.float32), np.zeros(1, np.float32)),
  ),
  (20.0, 5.0, 5.0, 1.0),
)


def test_judging_drives_the_training_path_in_the_plant_of_the_training():
  judged = judge(GOOD, PLAN, Model.nominal())
  assert judged.finished.all() and judged.rmse.shape == (4,) and np.all(judged.rmse < 0.03)
  wrong = dataclasses.replace(PLAN, options=dataclasses.replace(OPTIONS, steering_offset=10.0))
  assert abs(judge(GOOD, wrong, Model.nominal()).rmse[0] - judged.rmse[0]) > 1e-3
  sensed = dataclasses.replace(PLAN, options=dataclasses.replace(OPTIONS, estimator="fekf"))
  noisy = judge(GOOD, sensed, Model.nominal())
  assert len(set(noisy.rmse)) == 4 and np.all(judge(GOOD, sensed, Model.nominal()).rmse == noisy.rmse)


def test_the_best_is_kept_and_a_worse_one_does_not_replace_it(tmp_path, monkeypatch):
  scores = iter([0.02, 0.01, 0.03])

  def scripted(policy, plan, model, own_plant=None):
    value, one = next(scores), np.ones(4)
    return Kpis(value * one, value * one, one, one, one > 0, one > 0)

  monkeypatch.setattr(training, "judge", scripted)
  always = lambda self, episode: original(self, episode | {"finished": True})
  original = training.Keeper._count
  monkeypatch.setattr(training.Keeper, "_count", always)
  result = train(dataclasses.replace(PLAN, every=3), tmp_path)
  assert result["best_rmse_training_path"] == 0.01 and result["best_episode"] == 6
  assert load_policy(tmp_path / "best").provenance["episode"] == 6
  assert [row["rmse"] for row in rows(tmp_path / "evaluations.csv")] == [0.02, 0.01, 0.03]


def test_progress_is_what_a_checkpoint_gives_back():
  progress = Progress(episodes=[[1.0]], best=0.5, best_episode=1, resumed=2)
  assert Progress(**json.loads(json.dumps(dataclasses.asdict(progress)))) == progress
