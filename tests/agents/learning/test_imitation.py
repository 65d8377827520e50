"""Imitating a teacher that sees the truth; left and right learnt as one; two critics; linkages drawn anew."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import Logger

from agents.control.model import Model
from agents.control.tuning import Search
from agents.learning import imitation
from agents.learning.ddpg import MirrorBuffer, Settings, demonstrate, make_agent
from agents.learning.environments import Options, fleet, task_of
from agents.learning.evaluate import EvaluationCase, run_together
from agents.learning.imitation import imitate, teacher
from agents.learning.observation import ObservationSpec
from agents.learning.policy_file import load_policy
from agents.learning.train import Plan, judge, policy_of, train
from qcar_twin.envs.vector_env import FleetVecEnv
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from tests.agents.learning.test_train import SHORT, rows

MODEL = Model.nominal()
OPTIONS = Options(SHORT, plant="bicycle", estimator="truth", demonstrator="")
SETTINGS = Settings(episodes=0, cars=4, imitations=4, mirror=True, buffer=40_000)
PLAN = Plan(OPTIONS, SETTINGS, progress_bar=False)


@pytest.fixture(scope="module")
def student():
  with pytest.MonkeyPatch.context() as patch:
    patch.setattr(imitation, "ROUNDS", 2)
    patch.setattr(imitation, "STEPS", 300)
    agent = make_agent(FleetVecEnv(fleet(OPTIONS, range(4), MODEL)), SETTINGS, 0)
    error = imitate(agent, teacher(MODEL, 0.5), 4, 0)
  return agent, error


def test_a_student_that_sees_what_the_teacher_sees_does_what_it_does(student):
  agent, error = student
  policy, law = policy_of(agent, PLAN, {}), teacher(MODEL, 0.5)
  case = EvaluationCase("s", "bicycle", cars=1, estimator="truth")
  ours, theirs = (row.kpis for row in run_together({"ours": policy, "theirs": law}, case))
  assert error < 0.15
  assert ours.rmse[0] < theirs.rmse[0] + 1.5e-3
  errors = np.random.default_rng(0).normal(0.0, [0.002, 0.01, 0.01, 0.05], (500, 4))
  assert np.corrcoef(policy.rate(errors), law.answer(errors))[0, 1] > 0.95


def test_a_mirrored_student_steers_to_the_other_side(student):
  policy = policy_of(student[0], PLAN, {})
  errors = np.random.default_rng(1).normal(0.0, [0.003, 0.02, 0.02, 0.1], (300, 4))
  assert np.abs(policy.rate(errors) + policy.rate(-errors)).mean() < 0.1 * np.abs(policy.rate(errors)).mean()


def test_what_was_driven_is_in_the_replay_buffer_and_targets_are_the_student(student):
  agent, _ = student
  assert agent.replay_buffer.pos > 1000 and np.abs(agent.replay_buffer.actions[: agent.replay_buffer.pos]).max() <= 1.0
  for own, target in zip(agent.actor.parameters(), agent.actor_target.parameters(), strict=True):
    torch.testing.assert_close(own, target)


def test_answers_are_to_the_true_errors():
  """A car whose estimate is bent to one side is taught to steer to where it really is."""
  bent = dataclasses.replace(OPTIONS, plant="reduced", estimator="fekf", steering_offset=3.0)
  agent = make_agent(FleetVecEnv(fleet(bent, range(4), MODEL)), dataclasses.replace(SETTINGS, imitations=2), 0)
  law, asked = teacher(MODEL, 0.5), []
  env = agent.env.unwrapped
  original = env.step_wait

  def spy():
    asked.append(-env.fleet.errors.observation[1] @ law.gain / law.largest)
    return original()

  env.step_wait = spy
  _, answers = imitation._drive(agent, law, 1, False, np.random.default_rng(0))
  np.testing.assert_allclose(answers[:, 0], np.clip(np.concatenate(asked), -imitation.CUT, imitation.CUT))


def test_an_agent_that_only_imitates_is_judged_kept_and_exported(tmp_path, monkeypatch):
  monkeypatch.setattr(imitation, "ROUNDS", 1)
  monkeypatch.setattr(imitation, "STEPS", 150)
  result = train(PLAN, tmp_path)
  assert result["episodes"] == 0 and result["updates"] == 0 and result["best_episode"] == 0
  assert result["best_rmse_training_path"] < 0.03 and result["ten_full_episodes_in_a_row_at"] is None
  assert [row["episode"] for row in rows(tmp_path / "evaluations.csv")] == [0]
  assert load_policy(tmp_path / "best").provenance["training"]["settings"]["imitations"] == 4
  assert json.loads((tmp_path / "training.json").read_text())["settings"]["mirror"] is True


def test_imitation_is_not_repeated_by_resuming(tmp_path, monkeypatch):
  monkeypatch.setattr(imitation, "ROUNDS", 1)
  monkeypatch.setattr(imitation, "STEPS", 50)
  plan = dataclasses.replace(PLAN, settings=dataclasses.replace(SETTINGS, imitations=2))
  train(plan, tmp_path)
  monkeypatch.setattr("agents.learning.train.imitate", lambda *_: pytest.fail("imitated again"))
  assert train(plan, tmp_path, resume=True)["resumed"] == 1


# -- left and right, two critics ------------------------------------------------------------------


def test_a_mirror_turns_sight_and_action_but_not_the_reward():
  options = dataclasses.replace(OPTIONS, demonstrator="lq_ed", version="tuned")
  agent = make_agent(FleetVecEnv(fleet(options, range(4), MODEL)), SETTINGS, 0)
  demonstrate(agent, 1)
  buffer = agent.replay_buffer
  assert isinstance(buffer, MirrorBuffer)
  np.random.seed(0)
  batch = np.arange(200, 328)
  state = np.random.get_state()
  seen = buffer._get_samples(batch)
  np.random.set_state(state)
  plain = super(MirrorBuffer, buffer)._get_samples(batch)
  side = torch.sign(seen.actions * plain.actions)
  assert 20 < int((side < 0).sum()) < 110
  known = side[:, 0] != 0
  torch.testing.assert_close(seen.rewards.abs(), plain.rewards.abs())
  torch.testing.assert_close((side * plain.next_observations.abs())[known].abs(), seen.next_observations.abs()[known])
  torch.testing.assert_close(
    torch.sign(seen.observations * plain.observations)[known][:, :1], side[known], atol=0.0, rtol=0
  )


def test_td3_has_two_critics_and_ddpg_one():
  plain, twin = (
    make_agent(FleetVecEnv(fleet(OPTIONS, range(4), MODEL)), dataclasses.replace(SETTINGS, algorithm=name), 0)
    for name in ("ddpg", "td3")
  )
  assert (len(plain.critic.q_networks), len(twin.critic.q_networks)) == (1, 2)
  assert (plain.policy_delay, twin.policy_delay) == (1, 2)
  assert plain.target_noise_clip == 0.0 < twin.target_noise_clip
  twin.set_logger(Logger(None, []))
  imitation._drive(twin, teacher(MODEL, 0.5), 1, False, np.random.default_rng(0))
  before = [p.clone() for p in twin.actor.parameters()]
  twin.train(1, 16)
  assert all(torch.equal(a, b) for a, b in zip(before, twin.actor.parameters(), strict=True))
  twin.train(1, 16)
  assert not all(torch.equal(a, b) for a, b in zip(before, twin.actor.parameters(), strict=True))


# -- linkages -------------------------------------------------------------------------------------


def test_linkages_are_drawn_for_every_episode_within_their_spread():
  options = dataclasses.replace(OPTIONS, gain_spread=0.1, offset_spread=1.5, steering_gain=1.05)
  task, rng = task_of(options), np.random.default_rng(0)
  drawn = np.array([task.linkage(rng) for _ in range(400)])
  assert np.all(np.abs(drawn[:, 0] - 1.05) <= 0.1) and np.all(np.abs(np.degrees(drawn[:, 1])) <= 1.5)
  assert np.ptp(drawn[:, 0]) > 0.18 and np.ptp(np.degrees(drawn[:, 1])) > 2.8
  cars = fleet(options, [0, 1])
  before = cars.linkage.gain.copy()
  cars.restart(np.array([True, False]))
  assert cars.linkage.gain[0] != before[0] and cars.linkage.gain[1] == before[1]


def test_without_a_spread_nothing_is_drawn():
  rng, untouched = np.random.default_rng(5), np.random.default_rng(5)
  assert task_of(OPTIONS).linkage(rng) == (1.0, 0.0)
  assert rng.random() == untouched.random()


def test_the_judge_drives_bent_linkages_where_training_draws_them():
  plan = dataclasses.replace(PLAN, options=dataclasses.replace(OPTIONS, offset_spread=8.0))
  law = teacher(MODEL, 0.5)
  plain, bent = judge(law, PLAN, MODEL).iaca, judge(law, plan, MODEL).iaca
  assert np.ptp(plain) == 0.0 and bent[0] == bent[3] == plain[0] and len(set(bent)) == 3


def test_settings_without_episodes_need_imitation():
  assert Settings(episodes=0, imitations=1).episodes == 0
  with pytest.raises(ValueError, match="at least 1"):
    Settings(episodes=0)


def test_plan_with_a_sight_survives_json():
  plan = dataclasses.replace(PLAN, observation=ObservationSpec(True, (0.0, 0.3), True))
  assert Plan.from_json(json.loads(json.dumps(plan.as_json()))) == plan
  old = PLAN.as_json()
  seen = old.pop("observation")
  assert Plan.from_json(old | {"sight": seen}) == PLAN  # as earlier versions wrote it
  assert Plan.from_json(old) == PLAN


def test_a_teacher_for_a_car_of_its_own_is_tuned_on_it(tmp_path):
  """A steering that answers 80 ms late makes the usual gains swing; the teacher for that car asks for less."""
  late = Twin(MODEL.vehicle, select(["steering_delay"]), threads=1)
  save_twin(tmp_path / "late.toml", late, late.parameters.vector({"steering_delay": 0.08}), "late")
  usual, search = teacher(MODEL, 1.0), Search(candidates=6, elite=2, generations=2, path=SHORT)
  own = teacher(MODEL, 1.0, str(tmp_path / "late.toml"), search)
  assert own.largest == usual.largest and own.gain[0] < 0.7 * usual.gain[0]
