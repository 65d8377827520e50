"""Networks, schedules, demonstrations, checkpoints, wiring: the parts of training, without training long."""

import dataclasses

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import Logger

from agents.control.model import Model
from agents.learning import environments
from agents.learning.checkpoint import load_checkpoint, save_checkpoint
from agents.learning.ddpg import Settings, TwoPaths, demonstrate, make_agent
from agents.learning.dm_suite import suite
from agents.learning.environments import ENV_ID, Options, fleet, prior_spread, task_of
from qcar_twin.envs.task import Reward
from qcar_twin.envs.vector_env import FleetVecEnv
from qcar_twin.paths import PATHS

FAST = Options(plant="bicycle", estimator="truth")
SHORT = dataclasses.replace(FAST, path="random:1:2")  # 3 m, a turn between straights
SMALL = Settings(episodes=10, cars=4, warm_up=0, steps_per_update=4, buffer=8000)


def agent_of(settings=SMALL, seed=0, options=FAST):
  agent = make_agent(FleetVecEnv(fleet(options, range(settings.cars))), settings, seed)
  agent.set_logger(Logger(None, []))
  return agent


# -- networks ------------------------------------------------------------------------------------


def test_networks_are_the_papers():
  agent = agent_of()
  actor = [layer for layer in agent.actor.mu if isinstance(layer, torch.nn.Linear)]
  assert [(x.in_features, x.out_features) for x in actor] == [(4, 200), (200, 200), (200, 1)]
  assert isinstance(agent.actor.mu[-1], torch.nn.Tanh)
  for critic in (agent.critic, agent.critic_target):
    assert len(critic.q_networks) == 1 and isinstance(critic.q_networks[0], TwoPaths)
    sizes = {name: tuple(p.shape) for name, p in critic.q_networks[0].named_parameters() if p.ndim == 2}
    assert sorted(sizes.values()) == [(1, 200), (100, 1), (200, 4), (200, 100), (200, 200)]
  assert torch.get_num_threads() == 1


def test_critic_lets_the_best_action_depend_on_the_observation():
  """Its mixed difference in observation and action is not zero."""
  torch.manual_seed(0)
  value = TwoPaths(4, 1)
  s, other = torch.zeros(1, 4), torch.ones(1, 4)
  low, high = torch.full((1, 1), -1.0), torch.full((1, 1), 1.0)
  mixed = sum(
    sign * value(torch.cat(pair, dim=1))
    for sign, pair in ((1, (s, low)), (-1, (s, high)), (-1, (other, low)), (1, (other, high)))
  )
  assert abs(float(mixed.detach())) > 1e-3


def test_optimisers_hold_the_critic_that_is_used():
  agent = agent_of()
  held = {id(p) for group in agent.critic.optimizer.param_groups for p in group["params"]}
  used = {id(p) for p in agent.critic.q_networks[0].parameters()}
  assert used == held


def test_observations_are_scaled_inside_the_network():
  agent = agent_of()
  observation = torch.tensor([[0.05, 0.1, -0.1, 0.3]])
  scaled = observation * torch.tensor(SMALL.observation_scale)
  torch.testing.assert_close(agent.actor(observation), agent.actor.mu(scaled))


def test_rates_and_noise_fade_until_most_of_the_training_is_done():
  agent = agent_of()
  rates = []
  for done in (0.0, 0.4, 0.8, 1.0):
    agent.advance(done)
    agent._update_learning_rate([agent.actor.optimizer, agent.critic.optimizer])
    groups = (agent.actor.optimizer.param_groups[0]["lr"], agent.critic.optimizer.param_groups[0]["lr"])
    rates.append((*groups, agent.action_noise.noises[2]._sigma[0]))
  np.testing.assert_allclose(rates[0], [3e-4, 1e-3, 0.3])
  np.testing.assert_allclose(rates[1], [0.55 * 3e-4, 0.55 * 1e-3, 0.175])
  np.testing.assert_allclose(rates[2], [3e-5, 1e-4, 0.05])
  np.testing.assert_allclose(rates[3], rates[2])


@pytest.mark.parametrize("wrong", [{"episodes": 0}, {"cars": 3, "steps_per_update": 8}])
def test_impossible_settings_are_refused(wrong):
  with pytest.raises(ValueError, match="at least 1|multiple"):
    Settings(**wrong)


@pytest.mark.parametrize(("cars", "every"), [(1, (8, 1)), (8, (1, 1)), (16, (1, 2))])
def test_gradient_steps_follow_environment_steps(cars, every):
  agent = agent_of(dataclasses.replace(SMALL, cars=cars, steps_per_update=8))
  assert (agent.train_freq, agent.gradient_steps) == every or (
    agent.train_freq.frequency,
    agent.gradient_steps,
  ) == every


# -- demonstrations ------------------------------------------------------------------------------


def test_demonstrations_fill_the_buffer_with_what_the_demonstrator_does():
  options = dataclasses.replace(FAST, demonstrator="lq_ed", version="tuned")
  agent = agent_of(options=options)
  count = demonstrate(agent, 1)
  buffer = agent.replay_buffer
  assert count == 4 * buffer.pos and 1100 * 4 < count < 1700 * 4
  seen, taken = buffer.observations[: buffer.pos], buffer.actions[: buffer.pos]
  assert np.abs(seen[200:, :, 0]).mean() < 0.02
  assert np.abs(taken).max() <= 1.0 and 0.001 < np.abs(taken).mean() < 0.5
  reward = buffer.rewards[200 : buffer.pos].mean()
  assert reward > 0.4
  moved = buffer.next_observations[: buffer.pos - 1]
  ends = buffer.dones[: buffer.pos - 1].astype(bool)
  np.testing.assert_array_equal(moved[~ends], buffer.observations[1 : buffer.pos][~ends])


# -- checkpoints ---------------------------------------------------------------------------------


def filled_agent(seed=0):
  agent = agent_of(seed=seed, options=SHORT)
  demonstrate(agent, 1)
  agent.train(5, 64)
  return agent


def weights(agent):
  return np.concatenate([p.detach().numpy().ravel() for p in agent.policy.parameters()])


def test_an_agent_goes_on_from_a_checkpoint_exactly_as_it_would_have(tmp_path):
  agent = filled_agent()
  agent.advance(0.3)
  agent.num_timesteps = 77
  save_checkpoint(agent, tmp_path, {"episodes": [[1.0, 2.0]]})
  agent.train(5, 64)
  expected = weights(agent)
  again = agent_of(seed=9, options=SHORT)
  assert load_checkpoint(again, tmp_path) == {"episodes": [[1.0, 2.0]]}
  assert again.num_timesteps == 77 and again._n_updates == 5 and again.done == 0.3
  again.train(5, 64)
  np.testing.assert_array_equal(weights(again), expected)
  assert again.action_noise.noises[0]._sigma == agent.action_noise.noises[0]._sigma


def test_only_the_last_checkpoint_is_kept_and_a_half_written_one_is_not_looked_at(tmp_path):
  agent = filled_agent()
  for steps in (10, 20):
    agent.num_timesteps = steps
    save_checkpoint(agent, tmp_path, {})
  assert [p.name for p in tmp_path.glob("checkpoint_*")] == ["checkpoint_20"]
  (tmp_path / "checkpoint_30").mkdir()
  (tmp_path / "checkpoint_30" / "arrays.npz").write_bytes(b"cut off")
  fresh = agent_of(seed=1)
  load_checkpoint(fresh, tmp_path)
  assert fresh.num_timesteps == 20


def test_a_checkpoint_holds_nothing_that_could_be_executed(tmp_path):
  save_checkpoint(filled_agent(), tmp_path, {})
  files = sorted(p.name for p in tmp_path.rglob("*") if p.is_file())
  assert files == ["arrays.npz", "checkpoint.json", "networks.safetensors"]
  with np.load(next(tmp_path.rglob("arrays.npz")), allow_pickle=False) as arrays:
    assert all(arrays[name].dtype != object for name in arrays.files)


def test_nothing_to_resume_and_a_foreign_buffer_are_said(tmp_path):
  with pytest.raises(FileNotFoundError, match="without --resume"):
    load_checkpoint(agent_of(), tmp_path)
  save_checkpoint(filled_agent(), tmp_path, {})
  with pytest.raises(ValueError, match="buffer of"):
    load_checkpoint(agent_of(dataclasses.replace(SMALL, cars=2, steps_per_update=2)), tmp_path)


# -- wiring --------------------------------------------------------------------------------------


def test_gymnasium_knows_the_environment_by_name():
  env = gymnasium.make(ENV_ID, plant="bicycle", estimator="truth", path="o", seed=3)
  observation, _ = env.reset(seed=3)
  assert env.observation_space.contains(observation) and env.unwrapped.fleet.task.path.name == "o"
  env.step(env.action_space.sample())


def test_suite_offers_every_path():
  assert suite().names == tuple(f"path_tracking_{name}" for name in PATHS)
  step = suite().load("path_tracking_c", seed=2).reset()
  assert step.first() and len(step.observation) == 4


def test_options_reach_the_task():
  options = Options(plant="bicycle", path="o", laps=2, speed=0.7, steering_gain=0.92, steering_offset=1.0)
  task = task_of(dataclasses.replace(options, reward=Reward(m6=2.0)))
  assert task.distance == pytest.approx(2 * task.path.length) and task.speed == 0.7 and task.reward.m6 == 2.0
  assert (task.steering_gain, task.steering_offset) == (0.92, pytest.approx(np.radians(1.0)))
  assert (task.servo_delay, task.servo_lag) == environments.SERVO
  assert task_of(Options()).servo_lag == 0.0


def test_unknown_demonstrator_names_those_there_are():
  with pytest.raises(ValueError, match="no demonstrator 'lqr': did you mean lq_|there are ff_fb, lq_ed, lq_cm"):
    dataclasses.replace(FAST, demonstrator="lqr")


def test_randomised_twins_differ_in_what_a_person_measures():
  cars = fleet(Options(estimator="truth", randomise="prior"), [0, 1])
  spread = prior_spread(cars.config.plant())
  assert "mass" in spread.names
  column = cars.config.plant().parameters.index("mass")
  masses = cars._theta[:, column]
  assert masses[0] != masses[1] and np.all(np.abs(masses / Model.nominal().vehicle.mass - 1.0) < 0.2)
