"""What a training by reward is asked for: files of hyperparameters, options of the command; and how it goes on."""

import contextlib
import dataclasses
import importlib.util
import json
import os
import pickle
import signal
import subprocess
import sys
import time
import warnings
import zipfile

import numpy as np
import pytest
from stable_baselines3.common.callbacks import BaseCallback

from agents.learning import by_reward
from agents.learning.by_reward import train_by_reward
from agents.learning.environments import ENV_ID, options_from
from agents.learning.hyperparameters import ALGORITHMS, file_of, read_hyperparameters
from agents.learning.observation import OBSERVATIONS
from agents.learning.policy_file import load_policy
from agents.learning.sb3_zip import policy_from_zip
from agents.learning.trial import CLOSEST, TRACKS, Trial, quickly, trial_from
from qcar_twin.untrusted import UnreadableFile
from scripts import train
from tests import ROOT

FAST = dataclasses.replace(TRACKS, plant="reduced", estimator="truth", path="random:1:60", stretch=2.0)
TABLE = f"{ENV_ID}:\n  n_timesteps: 2000\n  n_envs: 2\n"


@pytest.fixture(autouse=True)
def short_judgement(monkeypatch):
  """Two metres of track and two cars to choose the best policy by."""
  monkeypatch.setattr(by_reward, "KEPT_ASIDE", ("random:9:2",))
  monkeypatch.setattr(by_reward, "JUDGES", 2)


# -- files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_the_shipped_files_train_on_the_default_task(algorithm):
  hyper = read_hyperparameters(algorithm)
  assert options_from(hyper.env_kwargs) == TRACKS and hyper.steps >= 400_000
  assert hyper.policy_kwargs["activation_fn"] == "relu" and hyper.policy_kwargs["net_arch"] == [64, 64]
  assert (hyper.noise > 0.0) == (algorithm in ("td3", "ddpg"))


def test_a_file_is_read_as_the_zoo_reads_it(tmp_path):
  file = tmp_path / "mine.yml"
  more = """  n_timesteps: !!float 2e3
  n_envs: 2
  learning_rate: lin_3e-4
  train_freq: [1, step]
  batch_size: 64.0
  ent_coef: auto_0.1
  policy_kwargs: "dict(net_arch=dict(pi=[32], qf=[48, 48]), activation_fn=nn.Tanh)"
  noise_type: ornstein-uhlenbeck
  noise_std: 0.1
  normalize: "dict(norm_obs=False)"
"""
  file.write_text("default:\n" + more, encoding="utf-8")
  hyper = read_hyperparameters("sac", file)
  assert (hyper.steps, hyper.cars, hyper.noise, hyper.noise_type) == (2000, 2, 0.1, "ornstein-uhlenbeck")
  assert hyper.policy_kwargs == {"net_arch": {"pi": [32], "qf": [48, 48]}, "activation_fn": "tanh"}
  assert hyper.rest["train_freq"] == (1, "step") and hyper.normalise == {"norm_obs": False} and not hyper.env_kwargs
  assert isinstance(hyper.rest["batch_size"], int) and hyper.arguments()["learning_rate"](0.5) == pytest.approx(1.5e-4)


@pytest.mark.parametrize(
  "text, said",
  [
    (TABLE + "  learning_rat: 1\n", "ppo has no key 'learning_rat'; did you mean learning_rate"),
    (TABLE + "  learning_rate: fast\n", "learning_rate must be a number or falling like lin_1e-3, not 'fast'"),
    (TABLE + "  n_steps: 2.5\n", "n_steps must be a whole number, not 2.5"),
    (TABLE + "  rollout_buffer_class: mine\n", "rollout_buffer_class must be"),
    (TABLE + "  policy: CnnPolicy\n", "use MlpPolicy"),
    (TABLE + "  policy_kwargs: {net_arhc: [8]}\n", "policy_kwargs has no key 'net_arhc'; did you mean net_arch"),
    (TABLE + "  policy_kwargs: {net_arch: [64.5]}\n", "net_arch must be a list of whole numbers"),
    (TABLE + "  policy_kwargs: {net_arch: [wide]}\n", "net_arch must be a list of whole numbers"),
    (TABLE + "  policy_kwargs: {activation_fn: gelu}\n", "use nn.ReLU or nn.Tanh"),
    (TABLE + "  policy_kwargs: \"dict(a=__import__('os').getcwd())\"\n", "is no table; write it like"),
    (TABLE + "  normalize: true\n", "of order one already"),
    (TABLE + "  normalize: {norm_obs: false, norm_rewards: true}\n", "did you mean norm_reward"),
    (TABLE + "  noise_type: normal\n  noise_std: 0.1\n", "explores by its own policy"),
    (TABLE + "  env_kwargs: {plant: bycicle}\n", "did you mean bicycle"),
    (TABLE + "  env_kwargs: {reward: {m7: 1}}\n", "no weight of the reward 'm7'"),
    (TABLE.replace("2000", "0"), "n_timesteps must be a whole number from 1 on"),
    ("CartPole-v1:\n  n_envs: 2\n", f"has no table {ENV_ID}"),
    (TABLE + "  n_envs: 3\n", "duplicate key"),
    (TABLE + "  a: &x 1\n  b: *x\n", "has an alias"),
    (TABLE + "  a: !!python/object/apply:os.getcwd []\n", "not usable YAML"),
    ("- 1\n", "holds no table"),
  ],
)
def test_hyperparameters_that_are_none_are_refused(tmp_path, text, said):
  file = tmp_path / "mine.yml"
  file.write_text(text, encoding="utf-8")
  with pytest.raises((KeyError, UnreadableFile), match=said):
    read_hyperparameters("ppo", file)


def test_an_algorithm_or_a_format_there_is_not_is_refused(tmp_path):
  with pytest.raises(KeyError, match="did you mean ppo"):
    read_hyperparameters("ppoo")
  with pytest.raises(UnreadableFile, match="are a YAML file"):
    read_hyperparameters("ppo", tmp_path / "mine.toml")


# -- the command ---------------------------------------------------------------------------------


def asked_for(tmp_path, **options):
  defaults = {f.name: f.default for f in dataclasses.fields(train.Config)}
  return trial_from(vars(train.Config(tmp_path, **options)), defaults)


def test_options_of_the_command_reach_the_training_and_those_left_out_are_the_files(tmp_path):
  trial = asked_for(tmp_path, algorithm="ppo", path="random:4:90", estimator="truth", observation="history", seed=3)
  assert (trial.options.path, trial.options.stretch, trial.observation, trial.seed) == (
    "random:4:90",
    6.0,
    "history",
    3,
  )
  assert trial.options.reward.m6 == 0.0 and trial.options.demonstrator == "" and trial.options.plant == "reduced"
  assert trial.every == 16_000_000 // 12 and trial.critic == "truth"
  assert asked_for(tmp_path, algorithm="ppo").observation == "any_speed"
  assert (
    asked_for(tmp_path, algorithm="ppo", critic="own").critic == asked_for(tmp_path, algorithm="sac").critic == "own"
  )
  assert asked_for(tmp_path, algorithm="ppo", path="o").options.stretch == 0.0
  assert asked_for(tmp_path, algorithm="sac", quick=True).every == CLOSEST
  assert asked_for(tmp_path, algorithm="sac", plant="mujoco", steering_gain=0.9).options.plant == "mujoco"
  trial = asked_for(tmp_path, algorithm="ppo", unknown=("steering_gain",))
  assert trial.options.unknown == ("steering_gain",)
  (tmp_path / "training.json").write_text(json.dumps(trial.as_json()), encoding="utf-8")
  assert Trial.kept(tmp_path / "training.json") == trial
  with pytest.raises(ValueError, match="--episodes is of the paper's training"):
    asked_for(tmp_path, algorithm="td3", episodes=5)
  with pytest.raises(ValueError, match="sees the truth is for ppo; take --critic own"):
    asked_for(tmp_path, algorithm="sac", critic="truth")


def test_a_plan_of_an_earlier_version_names_its_plant_by_another_word(tmp_path):
  trial = asked_for(tmp_path, algorithm="sac", plant="mujoco")
  table = trial.as_json()
  table["options"]["plant"] = "twin"
  (tmp_path / "training.json").write_text(json.dumps(table), encoding="utf-8")
  assert Trial.kept(tmp_path / "training.json") == trial


def test_workers_and_device_of_the_command_reach_the_training(tmp_path, monkeypatch, capsys):
  given = {}
  monkeypatch.setattr(train, "train_by_reward", lambda trial, out, **options: given.update(options))
  monkeypatch.setattr(train, "in_words", lambda result: "done")
  train.main(train.Config(tmp_path, "ppo", workers=3, device="cuda", tensorboard=False))
  assert given == {"resume": False, "tensorboard": False, "device": "cuda", "workers": 3}


def test_a_value_is_refused_before_anything_is_written(tmp_path):
  (tmp_path / "mine.yml").write_text(TABLE + "  gamma: none\n", encoding="utf-8")
  with pytest.raises(UnreadableFile, match="gamma must be a number"):
    train.main(train.Config(tmp_path / "out", "ppo", tmp_path / "mine.yml"))
  wrong = dataclasses.replace(quickly(read_hyperparameters("ppo")), rest={"batch_size": -1})
  with pytest.raises(Exception, match="batch_size"):
    train_by_reward(Trial(wrong, FAST), tmp_path / "out")
  assert not (tmp_path / "out").exists()


def test_curves_are_left_out_where_nobody_wants_them(tmp_path):
  train_by_reward(Trial(quickly(read_hyperparameters("ppo")), FAST), tmp_path, tensorboard=False)
  assert not (tmp_path / "tensorboard").exists() and (tmp_path / "best" / "policy.onnx").is_file()


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_the_rl_zoo_takes_the_shipped_files_unmodified(algorithm, tmp_path):
  if importlib.util.find_spec("rl_zoo3") is None:
    pytest.skip("rl_zoo3 is not installed: pip install rl_zoo3 where this is to be tested")
  command = [sys.executable, "-m", "rl_zoo3.train", "--gym-packages", "agents.learning.environments", "--env", ENV_ID]
  command += ["--algo", algorithm, "--conf-file", str(file_of(algorithm)), "--n-timesteps", "64", "--log-folder"]
  command += [str(tmp_path), "--seed", "0", "--eval-freq", "-1", "--hyperparams", "n_envs:2"]
  command += ["learning_starts:16"] if algorithm != "ppo" else ["batch_size:64"]
  environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
  done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
  assert done.returncode == 0, done.stderr[-2000:]
  (made,) = tmp_path.rglob("*PathTracking-v1.zip")
  policy = policy_from_zip(made)
  assert policy.name == algorithm and policy.observation == OBSERVATIONS["any_speed"]


# -- going on ------------------------------------------------------------------------------------


class Stop(BaseCallback):
  """Stands for whatever stops a process at a step."""

  def __init__(self, at):
    super().__init__()
    self.at = at

  def _on_step(self):
    if self.num_timesteps >= self.at:
      raise KeyboardInterrupt
    return True


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_a_training_that_was_stopped_ends_in_the_weights_of_one_that_was_not(algorithm, tmp_path):
  hyper = dataclasses.replace(quickly(read_hyperparameters(algorithm)), normalise={"norm_obs": False}, steps=1500)
  trial = Trial(hyper, FAST, "history", every=400)
  whole = train_by_reward(trial, tmp_path / "whole", tensorboard=False)
  with contextlib.suppress(KeyboardInterrupt):
    train_by_reward(trial, tmp_path / "stopped", [Stop(1100)], tensorboard=False)
  stopped = json.loads((tmp_path / "stopped" / "checkpoint.json").read_text(encoding="utf-8"))
  assert 0 < stopped["steps"] < 1100 and not (tmp_path / "stopped" / "result.json").exists()
  kept = Trial.kept(tmp_path / "stopped" / "training.json")
  resumed = train_by_reward(kept, tmp_path / "stopped", resume=True, tensorboard=False)
  for name in ("steps", "updates", "best_steps", "best_rmse_kept_aside"):
    assert resumed[name] == whole[name]
  assert (whole["resumed"], resumed["resumed"]) == (0, 1)
  one, other = (policy_from_zip(tmp_path / name / "model.zip") for name in ("whole", "stopped"))
  for (a, b), (c, d) in zip(one.layers, other.layers, strict=True):
    np.testing.assert_array_equal(a, c)
    np.testing.assert_array_equal(b, d)
  tables = [(tmp_path / name / "evaluations.csv").read_text(encoding="utf-8") for name in ("whole", "stopped")]
  without_clocks = [[line.split(",")[:5] for line in table.splitlines()] for table in tables]
  assert without_clocks[0] == without_clocks[1]
  assert train_by_reward(trial, tmp_path / "stopped", resume=True) == resumed


def test_a_training_nobody_evaluates_keeps_what_it_ends_with(tmp_path):
  trial = Trial(quickly(read_hyperparameters("ppo")), FAST, every=0)
  result = train_by_reward(trial, tmp_path / "run", tensorboard=False)
  assert result["best_steps"] == result["steps"] and result["best_rmse_kept_aside"] is None
  assert len((tmp_path / "run" / "evaluations.csv").read_text(encoding="utf-8").splitlines()) == 1
  assert not (tmp_path / "run" / "checkpoint.json").exists()
  last, kept = policy_from_zip(tmp_path / "run" / "model.zip"), load_policy(tmp_path / "run" / "best")
  for (a, b), (c, d) in zip(last.layers, kept.layers, strict=True):
    np.testing.assert_array_equal(a, c)
    np.testing.assert_array_equal(b, d)


@pytest.mark.slow
def test_a_killed_command_is_resumed_by_its_own_plan(tmp_path):
  folder = tmp_path / "run"
  (tmp_path / "mine.yml").write_text(
    TABLE.replace("2000", "60000") + "  n_steps: 64\n  batch_size: 128\n  env_kwargs: {plant: reduced, path: o}\n",
    encoding="utf-8",
  )
  command = [sys.executable, "-m", "scripts", "train", "--out", str(folder)]
  asked = ["--algorithm", "ppo", "--hyperparameters", str(tmp_path / "mine.yml"), "--estimator", "truth"]
  environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
  first = subprocess.Popen([*command, *asked], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL)
  deadline = time.monotonic() + 900.0  # a machine may be busy; there is no other end to wait for
  while not (folder / "checkpoint.json").exists() and first.poll() is None and time.monotonic() < deadline:
    time.sleep(0.005)
  first.send_signal(signal.SIGKILL)
  assert first.wait() == -signal.SIGKILL and not (folder / "result.json").exists()
  plan = json.loads((folder / "training.json").read_text(encoding="utf-8"))
  plan["hyperparameters"]["steps"] = 2000  # so that the test is over soon
  (folder / "training.json").write_text(json.dumps(plan), encoding="utf-8")
  done = subprocess.run([*command, "--resume"], cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
  assert done.returncode == 0 and "mm RMSE on tracks kept aside" in done.stdout, done.stderr[-2000:]
  result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
  assert result["resumed"] == 1 and result["steps"] >= 2000
  assert load_policy(folder / "best").name == "ppo"


def test_what_cannot_be_resumed_is_said(tmp_path):
  trial = Trial(quickly(read_hyperparameters("sac")), FAST, every=50)
  with pytest.raises(FileNotFoundError, match="start without --resume"):
    train_by_reward(trial, tmp_path / "empty", resume=True)
  with contextlib.suppress(KeyboardInterrupt):
    train_by_reward(trial, tmp_path / "run", [Stop(200)], tensorboard=False)
  with pytest.raises(FileExistsError, match="go on with --resume"):
    train_by_reward(trial, tmp_path / "run")
  with pytest.raises(ValueError, match="holds another training"):
    train_by_reward(dataclasses.replace(trial, seed=5), tmp_path / "run", resume=True)
  (archive,) = (tmp_path / "run").glob("checkpoint_*/model.zip")
  with zipfile.ZipFile(archive, "a") as more, warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of a name that is there twice: the last counts
    more.writestr("policy.pth", pickle.dumps(print, protocol=2))
  with pytest.raises(UnreadableFile, match="holds more than tensors"):
    train_by_reward(trial, tmp_path / "run", resume=True)
  archive.write_bytes(b"no zip")
  with pytest.raises(UnreadableFile, match="is no checkpoint of this training"):
    train_by_reward(trial, tmp_path / "run", resume=True)


def test_the_files_that_come_along_are_named_after_their_algorithms():
  """One each, and variants with a word more."""
  stems = {p.stem for p in file_of("ppo").parent.iterdir()}
  assert {file_of(name).stem for name in ALGORITHMS} == {s for s in stems if "_" not in s}
  assert {s.split("_")[0] for s in stems} == set(ALGORITHMS)
