"""What an agent sees beyond the four errors: the same in training and in a drive, in SI units, remembered rightly."""

import dataclasses

import numpy as np
import pytest

from agents.control.closed_loop import Actuation, Scenario, drive
from agents.control.interface import Situation
from agents.control.model import Model
from agents.control.speed import SpeedGains
from agents.learning.environments import SERVO, Options, fleet
from agents.learning.observation import OBSERVATIONS, ObservationSpec
from agents.learning.policy_file import Policy, export_onnx, load_policy, onnx_difference, save_policy
from qcar_twin.envs.spaces import Interface
from qcar_twin.envs.vector_env import FleetVecEnv
from qcar_twin.estimation.observer import TrueObserver
from qcar_twin.paths import path_named
from qcar_twin.slow_means import MEMORY, remember
from qcar_twin.untrusted import UnreadableFile

WIDE, HISTORY, ANY_SPEED = OBSERVATIONS["wide"], OBSERVATIONS["history"], OBSERVATIONS["any_speed"]
OPTIONS = Options(plant="bicycle", estimator="truth", start_offset=0.0, start_heading=0.0)
RNG = np.random.default_rng(0)


def steering_policy(spec=WIDE):
  """A network that does what a linear law on errors, command and curvature would."""
  weights = np.zeros((2, spec.size), np.float32)
  weights[0, :4], weights[0, 4:] = (-1.5, -1.3, -1.0, -1.0), 0.05
  weights[1] = -weights[0]
  layers = ((weights, np.zeros(2, np.float32)), (np.array([[1.0, -1.0]], np.float32), np.zeros(1, np.float32)))
  return Policy(layers, (20.0, 5.0, 5.0, 1.0, *spec.scale), observation=spec)


def test_the_means_are_first_order_lags():
  past = np.zeros((1, 2))
  for _ in range(250):
    past = remember(past, np.array([0.2]), np.array([-1.5]), 0.01)
  expected = 1.0 - (1.0 - 0.01 / MEMORY) ** 250
  np.testing.assert_allclose(past, expected * np.array([[0.2, -1.5]]), rtol=1e-12)
  still = remember(past, past[:, 0], past[:, 1], 0.01)
  np.testing.assert_allclose(still, past, rtol=1e-12)


@pytest.mark.parametrize(
  "sight",
  [
    ObservationSpec(),
    ObservationSpec(steering=True),
    ObservationSpec(previews=(0.0, 0.1)),
    ObservationSpec(past=True),
    WIDE,
  ],
)
def test_size_names_and_scale_fit_what_is_looked_at(sight):
  errors, past = RNG.standard_normal((3, 4)), RNG.standard_normal((3, 2))
  seen = sight.look(errors, np.array([0.1, 0.2, 0.3]), past, path_named("o"), np.array([0.0, 1.0, 2.0]))
  assert seen.shape == (3, sight.size) and len(sight.names) == sight.size == 4 + len(sight.scale)
  np.testing.assert_array_equal(seen[:, :4], errors)
  if sight.past:
    np.testing.assert_array_equal(seen[:, -2:], past)


def test_curvature_is_seen_as_far_ahead_as_asked_and_over_the_end_of_a_lap():
  path = path_named("o")
  near_end = np.array([path.length - 0.05])
  seen = ObservationSpec(previews=(0.0, 0.8)).look(np.zeros((1, 4)), np.zeros(1), np.zeros((1, 2)), path, near_end)
  np.testing.assert_allclose(seen[0, 4:], [path.at(near_end[0]).curvature, path.at(0.75).curvature])
  assert seen[0, 5] > 0.1


@pytest.mark.parametrize("sight", [WIDE, HISTORY, ANY_SPEED], ids=["wide", "history", "any_speed"])
def test_training_and_drive_show_the_agent_the_same(sight):
  """A policy steers a fleet in training as it steers a drive, bit for bit, so that what is learnt is what counts."""
  policy, model = steering_policy(sight), Model.nominal()
  env = FleetVecEnv(fleet(dataclasses.replace(OPTIONS, speed=1.0), [0], model), sight)
  observation, commands = env.reset(), []
  for _ in range(500):  # of some 640: through the turns to both sides
    observation, _, done, _ = env.step(policy.rate(observation.astype(np.float64))[:, None])
    assert not done.any()
    commands.append(env.fleet.steering[0])
  plant, theta = model.plant("bicycle")
  task = Scenario(path_named("s"), speed=1.0, lock=model.vehicle.max_steering, actuation=Actuation(*SERVO))
  driven = drive(plant, theta[None], policy, SpeedGains.design(model.car), TrueObserver(), task)
  # observations pass through single precision in training
  np.testing.assert_allclose(driven.commands[:500, 0, 1], commands, atol=2e-4)
  assert np.ptp(commands) > 0.5


def test_a_restarted_car_remembers_nothing():
  cars = fleet(OPTIONS, [0, 1])
  for _ in range(200):
    cars.step(np.full(2, 0.5))
  assert np.abs(cars.past).min() > 0.0
  cars.restart(np.array([True, False]))
  assert np.all(cars.past[0] == 0.0) and np.all(cars.past[1, 0] != 0.0)


def test_history_is_what_was_seen_so_long_ago():
  cars, rows = fleet(OPTIONS, [0, 1]), []
  for k in range(150):
    seen = HISTORY.of(cars)
    rows.append(np.stack([seen[:, 0], seen[:, 2], seen[:, 4], seen[:, 5]], axis=-1))
    for i, lag in enumerate((20, 40, 60, 80, 100)):
      np.testing.assert_array_equal(seen[:, 7 + 4 * i : 11 + 4 * i], rows[max(k - lag, 0)])
    cars.step(np.full(2, 0.4 * (-1) ** (k // 30)))
  assert HISTORY.size == 27 and HISTORY.names[7] == "cross_track_error 0.2 s ago m"
  cars.restart(np.array([True, False]))
  seen = HISTORY.of(cars)
  assert np.all(seen[0, [9, 13, 17]] == 0.0) and np.all(seen[0, 7::4] == seen[0, 0]) and np.any(seen[1, 9::4] != 0.0)


def test_a_look_further_back_than_is_remembered_is_refused(tmp_path):
  policy = dataclasses.replace(
    steering_policy(HISTORY), observation=dataclasses.replace(HISTORY, history=(0.2,) * 4 + (1.5,))
  )
  save_policy(policy, tmp_path)
  with pytest.raises(UnreadableFile, match="a look back of more than 1 s"):
    load_policy(tmp_path)
  with pytest.raises(ValueError, match="give `recent`"):
    HISTORY.look(np.zeros((1, 4)), np.zeros(1), np.zeros((1, 2)), path_named("o"), np.zeros(1))
  with pytest.raises(ValueError, match="give `speed`"):
    ObservationSpec(speed=True).look(np.zeros((1, 4)), np.zeros(1), np.zeros((1, 2)), path_named("o"), np.zeros(1))


def test_the_last_words_of_an_episode_are_seen_before_the_restart():
  env = FleetVecEnv(fleet(dataclasses.replace(OPTIONS, path="o"), [0, 1]), WIDE)
  env.reset()
  for _ in range(2000):
    observation, _, done, infos = env.step(np.array([[1.5], [0.0]], np.float32))
    if done[0]:
      break
  last = infos[0]["terminal_observation"]
  assert last.shape == observation[0].shape == (WIDE.size,)
  assert abs(last[0]) > 0.15 and last[4] > 0.1 and last[-2] > 0.0
  assert observation[0, 4] == 0.0 and np.all(observation[0, -2:] == 0.0)


def test_the_environment_says_how_much_is_seen():
  env = FleetVecEnv(fleet(OPTIONS, [0]), WIDE)
  assert env.observation_space == Interface(WIDE).observation_space and env.reset().shape == (1, 9)
  assert FleetVecEnv(fleet(OPTIONS, [0])).observation_space.shape == (4,)


@pytest.mark.parametrize("sight", [WIDE, HISTORY], ids=["wide", "history"])
def test_a_policy_that_sees_more_survives_its_file_and_its_export(sight, tmp_path):
  policy = steering_policy(sight)
  save_policy(policy, tmp_path)
  again = load_policy(tmp_path)
  assert again.observation == sight and again.observation_scale == policy.observation_scale
  observations = RNG.standard_normal((20, sight.size))
  np.testing.assert_array_equal(again.rate(observations), policy.rate(observations))
  assert export_onnx(policy, tmp_path / "policy.onnx") < 1e-5
  assert onnx_difference(policy, tmp_path / "policy.onnx", seed=3) < 1e-5


def test_a_situation_without_a_past_shows_zeros_to_a_controller_that_does_not_ask():
  fields = {f.name: f for f in dataclasses.fields(Situation)}
  assert fields["past"].default_factory().shape == (1, 2)
