"""A critic that sees the truth: what it is told, that the actor is not, that its training leaves a plain policy."""

import dataclasses

import numpy as np
import pytest
import torch

from agents.control.model import Model
from agents.learning import by_reward
from agents.learning.by_reward import make_agent, train_by_reward
from agents.learning.critic import TruthBesides
from agents.learning.environments import Options, fleet
from agents.learning.hyperparameters import read_hyperparameters
from agents.learning.observation import OBSERVATIONS
from agents.learning.policy_file import load_policy
from agents.learning.sb3_zip import policy_from_zip
from agents.learning.trial import TRACKS, Trial, quickly
from qcar_twin.envs.driven_cars import TRUE
from qcar_twin.plant import signal_index

FAST = dataclasses.replace(TRACKS, plant="reduced", estimator="truth", path="random:1:60", stretch=2.0)
SIGHT = OBSERVATIONS["any_speed"]
TRIAL = Trial(quickly(read_hyperparameters("ppo")), FAST, "any_speed", every=10**9, critic="truth")


@pytest.fixture(autouse=True)
def short_judgement(monkeypatch):
  """Two metres of track and two cars to choose the best policy by."""
  monkeypatch.setattr(by_reward, "KEPT_ASIDE", ("random:9:2",))
  monkeypatch.setattr(by_reward, "JUDGES", 2)


def test_the_critic_is_told_true_errors_and_the_linkage_behind_what_the_actor_sees():
  cars = fleet(Options(plant="bicycle", gain_spread=0.1, offset_spread=1.5), [0, 1, 2])
  for _ in range(30):
    cars.step(np.full(3, 0.2))
  view, count = TruthBesides(SIGHT), SIGHT.size
  seen = view.of(cars)
  assert seen.shape == (3, view.size) and len(view.scale) == view.size - 4
  np.testing.assert_array_equal(seen[:, :count], SIGHT.of(cars))
  np.testing.assert_array_equal(seen[:, count : count + 4], cars.errors.observation[TRUE])
  assert np.all(seen[:, count] != seen[:, 0])  # the filter errs
  np.testing.assert_array_equal(seen[:, count + 5], cars.signals[:, signal_index("steering_angle")])
  gain, offset = cars.linkage.gain, cars.linkage.offset
  np.testing.assert_array_equal(seen[:, -2:], np.stack([gain - 1.0, offset], axis=-1))
  assert np.ptp(gain) > 0.01 and np.all(np.abs(np.degrees(offset)) <= 1.5)


def test_the_truth_moves_the_value_and_not_the_action():
  policy = make_agent(TRIAL, Model.nominal()).policy
  seen = torch.randn(5, TruthBesides(SIGHT).size, generator=torch.Generator().manual_seed(0))
  other = seen.clone()
  other[:, SIGHT.size :] += 1.0
  with torch.no_grad():
    actions = [policy.get_distribution(x).mode() for x in (seen, other)]  # type: ignore[operator]
    values = [policy.predict_values(x) for x in (seen, other)]  # type: ignore[operator]
  assert torch.equal(*actions) and not torch.any(values[0] == values[1])
  assert policy.mlp_extractor.policy_net[0].in_features == SIGHT.size  # type: ignore[union-attr, operator]


def test_what_is_kept_sees_what_a_car_sees(tmp_path):
  train_by_reward(TRIAL, tmp_path, tensorboard=False)
  policy, zipped = load_policy(tmp_path / "best"), policy_from_zip(tmp_path / "model.zip")
  assert policy.observation == zipped.observation == SIGHT and policy.updates
  assert Trial.kept(tmp_path / "training.json") == TRIAL


@pytest.mark.slow
def test_cars_in_two_processes_leave_the_weights_of_cars_in_one(tmp_path, monkeypatch):
  monkeypatch.setattr(torch, "set_num_threads", lambda count: None)  # threads round sums otherwise
  trial = dataclasses.replace(TRIAL, every=1024)
  for workers in (1, 2):
    train_by_reward(trial, tmp_path / str(workers), tensorboard=False, workers=workers)
  one, two = (policy_from_zip(tmp_path / str(workers) / "model.zip") for workers in (1, 2))
  for (a, b), (c, d) in zip(one.layers, two.layers, strict=True):
    np.testing.assert_array_equal(a, c)
    np.testing.assert_array_equal(b, d)
