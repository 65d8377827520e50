"""Learning by reward alone: hyperparameters, what a training leaves, zips of stable-baselines3, comparisons."""

import base64
import contextlib
import dataclasses
import json
import os
import pickle
import zipfile

import numpy as np
import pytest
from stable_baselines3.common.callbacks import BaseCallback

from agents.control.controllers import FILE
from agents.control.kpis import kpis
from agents.control.team import Team
from agents.learning import by_reward
from agents.learning.by_reward import train_by_reward
from agents.learning.environments import Options, make_env
from agents.learning.evaluate import EvaluationCase, described, run_case, run_together
from agents.learning.hyperparameters import ALGORITHMS, read_hyperparameters
from agents.learning.policy_file import IMITATION, SHIPPED, load_policy, onnx_difference
from agents.learning.sb3_zip import any_policy, policy_from_zip
from agents.learning.trial import TRACKS, Trial, quickly
from agents.studies import comparison
from agents.studies.comparison import Design, compare, drivers_of, in_markdown, paired
from qcar_twin.rendering.film import RenderingUnavailable
from qcar_twin.untrusted import UnreadableFile
from scripts import evaluate, render
from tests import ROOT

SHORT = "random:1:2"  # 3 m, a turn between straights
FAST = dataclasses.replace(TRACKS, plant="reduced", estimator="truth", path="random:1:60", stretch=2.0)


@pytest.fixture(autouse=True)
def short_judgement(monkeypatch):
  """Two metres of track and two cars to choose the best policy by."""
  monkeypatch.setattr(by_reward, "KEPT_ASIDE", ("random:9:2",))
  monkeypatch.setattr(by_reward, "JUDGES", 2)


class Counter(BaseCallback):
  """A callback of the user's."""

  def __init__(self):
    super().__init__()
    self.steps = 0

  def _on_step(self):
    self.steps += 1
    return True


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_every_algorithm_learns_by_one_option_and_its_zip_is_read(algorithm, tmp_path):
  counter, hyper = Counter(), quickly(read_hyperparameters(algorithm))
  result = train_by_reward(Trial(hyper, FAST, every=10**9), tmp_path, [counter])
  assert result["updates"] > 0 and counter.steps * hyper.cars >= hyper.steps
  assert list((tmp_path / "tensorboard").glob("events*")) and (tmp_path / "best" / "policy.onnx").is_file()
  policy, out_of_zip = load_policy(tmp_path / "best"), policy_from_zip(tmp_path / "model.zip")
  assert policy.name == out_of_zip.name == algorithm and policy.updates and out_of_zip.updates
  model, env = ALGORITHMS[algorithm].load(tmp_path / "model.zip"), make_env(plant="bicycle", estimator="truth")
  seen, _ = env.reset(seed=3)
  for _ in range(40):
    action, _ = model.predict(seen, deterministic=True)
    si = out_of_zip.observation.of(env.fleet)
    assert out_of_zip.rate(si)[0] == pytest.approx(1.5 * float(action[0]), abs=2e-5)
    seen, *_ = env.step(action)
  with pytest.raises(FileExistsError, match="choose another folder"):
    train_by_reward(Trial(hyper, FAST), tmp_path)


def test_a_zip_of_si_units_and_four_errors_is_read(tmp_path):
  from stable_baselines3 import PPO

  env = make_env(plant="bicycle", estimator="truth", observation="errors", normalised=False)
  model = PPO("MlpPolicy", env, n_steps=32, batch_size=32, device="cpu", seed=0)
  model.save(tmp_path / "mine.zip")
  policy = policy_from_zip(tmp_path / "mine.zip")
  assert policy.hidden == "tanh" and policy.bound == "clip" and policy.updates == 0
  seen, _ = env.reset(seed=1)
  for _ in range(20):
    action, _ = model.predict(seen, deterministic=True)
    assert policy.rate(env.fleet.observation)[0] == pytest.approx(float(action[0]), abs=2e-5)
    seen, *_ = env.step(action)


def test_a_users_zip_and_path_go_through_evaluate_and_render(tmp_path, capsys):
  from stable_baselines3 import SAC

  env = make_env(plant="bicycle", estimator="truth", path="random:5:6")
  SAC("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, device="cpu", seed=0).save(tmp_path / "mine.zip")
  rows = "\n".join(f"{0.1 * k},{0.02 * np.sin(0.5 * k):.4f}" for k in range(12))
  (tmp_path / "mine.csv").write_text("x,y\n" + rows + "\n", encoding="utf-8")
  config = evaluate.Config(
    tmp_path / "out", policy=(tmp_path / "mine.zip",), paths=(str(tmp_path / "mine.csv"),), plants=("bicycle",), cars=1
  )
  evaluate.main(config)
  assert "sac: imitation of a teacher" not in (said := capsys.readouterr().out) and "sac: no update by reward" in said
  stored = json.loads((tmp_path / "out" / "evaluation.json").read_text())
  assert stored["policies"]["sac 0"]["kind"] == "sac" and len(stored["policies"]["sac 0"]["sha256"]) == 64
  assert (tmp_path / "out" / "tracking_mine.png").is_file()
  film = render.Config(
    tmp_path / "film.mp4", policy=tmp_path / "mine.zip", path=str(tmp_path / "mine.csv"), plant="bicycle", quick=True
  )
  try:
    render.main(film)
  except RenderingUnavailable as error:
    pytest.skip(str(error))
  assert (tmp_path / "film.mp4").stat().st_size > 1000


class Trap:
  """What leaves a mark where it is unpickled."""

  def __init__(self, mark):
    self.mark = mark

  def __reduce__(self):
    return os.mkdir, (str(self.mark),)


def test_nothing_in_a_zip_is_unpickled(tmp_path):
  from stable_baselines3 import PPO

  env, mark = make_env(plant="bicycle", estimator="truth"), tmp_path / "mark"
  PPO("MlpPolicy", env, n_steps=32, batch_size=32, device="cpu").save(tmp_path / "good.zip")
  with zipfile.ZipFile(tmp_path / "good.zip") as archive:
    parts = {name: archive.read(name) for name in archive.namelist()}
  trap = pickle.dumps(Trap(mark), protocol=2)  # torch's own
  data = json.loads(parts["data"])
  data["policy_class"][":serialized:"] = base64.b64encode(trap).decode()
  for name, changes in (("data", {"data": json.dumps(data).encode()}), ("tensors", {"policy.pth": trap})):
    with zipfile.ZipFile(tmp_path / f"{name}.zip", "w") as archive:
      for part, content in (parts | changes).items():
        archive.writestr(part, content)
  assert policy_from_zip(tmp_path / "data.zip").name == "ppo"  # the pickles in its JSON are passed over
  with pytest.raises(UnreadableFile, match=r"tensors.zip: policy.pth holds more than tensors"):
    policy_from_zip(tmp_path / "tensors.zip")
  assert not mark.exists()
  with contextlib.suppress(Exception):
    PPO.load(tmp_path / "data.zip", device="cpu")
  assert mark.exists()  # the trap works where a zip is loaded by stable-baselines3 itself


def test_what_is_no_zip_of_a_policy_is_refused(tmp_path):
  (tmp_path / "text.zip").write_text("no zip", encoding="utf-8")
  with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
    archive.writestr("data", "{}")
  for name in ("text.zip", "other.zip"):
    with pytest.raises(UnreadableFile, match="no zip that stable-baselines3 saved"):
      any_policy(tmp_path / name)
  with pytest.raises(FileNotFoundError, match="model.save"):
    any_policy(tmp_path / "nowhere.zip")


# -- what ships ----------------------------------------------------------------------------------


def test_the_shipped_agent_learnt_by_reward_and_the_imitation_says_what_it_is():
  agent, imitation = load_policy(SHIPPED), load_policy(IMITATION)
  assert agent.name in ALGORITHMS and agent.updates and agent.updates > 0
  assert agent.provenance["training"]["options"]["reward"]["m6"] == 0.0
  assert imitation.name == "imitation" and imitation.updates == 0 and "imitation of a teacher" in imitation.about
  for folder, policy in ((SHIPPED, agent), (IMITATION, imitation)):
    assert onnx_difference(policy, folder / "policy.onnx") < 1e-5


def test_the_shipped_agents_evaluation_is_its_own():
  stored = json.loads((SHIPPED / "evaluation.json").read_text(encoding="utf-8"))
  assert described(SHIPPED) in stored["policies"].values()


def test_the_registered_environment_can_show_what_the_shipped_agent_sees():
  env, policy = make_env(plant="bicycle", estimator="truth", observation="any_speed"), load_policy(SHIPPED)
  assert env.observation_space.shape == (policy.observation.size,)
  np.testing.assert_allclose(env.interface.scale, policy.observation_scale)


def test_nothing_is_called_ddpg_that_is_not():
  for file in (ROOT / "scripts" / "evaluate.py", ROOT / "scripts" / "render.py"):
    assert "ddpg" not in file.read_text(encoding="utf-8").lower()


# -- comparisons ---------------------------------------------------------------------------------


def test_paired_differences_have_students_interval():
  rng = np.random.default_rng(0)
  shared, gap = rng.normal(0.005, 0.002, (1, 40)), rng.normal(-0.001, 0.0002, (1, 40))
  difference = paired(shared + gap, shared)
  assert difference.count == 40 and difference.verdict == "less" and difference.mean == pytest.approx(gap.mean())
  assert difference.half_width == pytest.approx(2.0227 * gap.std(ddof=1) / np.sqrt(40), rel=1e-4)
  assert paired(shared, shared).verdict == "open" and paired(shared, shared + gap).verdict == "more"
  tracks = paired(np.zeros((5, 8)), np.repeat(np.arange(5.0)[:, None], 8, axis=1))
  assert tracks.count == 5 and tracks.mean == -2.0


def test_a_comparison_drives_everybody_in_the_same_noise(monkeypatch):
  drivers = drivers_of([SHIPPED, SHIPPED], [FILE], ["linear_rate"], 0.5)
  assert list(drivers) == ["ppo", "ppo #2", "linear_rate (controllers)"]
  monkeypatch.setattr(comparison, "PATHS", (SHORT,))
  driven = compare(drivers, Design("reduced", streams=2, tracks=0))
  for courses in driven.values():
    for values in courses.values():
      np.testing.assert_array_equal(values["ppo"], values["ppo #2"])
      assert np.all((values["ppo"] > 0.0) & (values["ppo"] < 0.1))
  text = in_markdown(driven, "ppo")
  assert "| ppo #2 | +0.00 ± 0.00" in text and f"{SHORT} N" in text and f"{SHORT} MIS" in text
  assert Options().path == "s"


def test_a_beginning_that_does_not_count_is_left_out():
  drivers = drivers_of([], [FILE], ["linear_rate"], 0.5)
  case = EvaluationCase(SHORT, "reduced", cars=2)
  late = run_together(drivers, dataclasses.replace(case, after=3.0))[0].kpis
  drive = run_case(Team(tuple(drivers.values()), 2), case)
  counted = drive.under_way & (drive.time >= 3.0)[:, None]
  expected = [np.sqrt(np.mean(drive.cross_track[counted[:, i], i] ** 2)) for i in range(2)]
  np.testing.assert_allclose(late.rmse, expected)
  assert late.finished.all() and np.all(late.rmse != kpis(drive).rmse)
