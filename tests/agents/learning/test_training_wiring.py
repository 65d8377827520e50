"""What a training is made of fits together: plan, plant, demonstrator, judge, tables, seeds, logs."""

import csv
import dataclasses
import json
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.buffers import ReplayBuffer
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from agents.control.controllers import load
from agents.control.interface import Situation
from agents.control.kpis import kpis
from agents.control.model import Model
from agents.learning import by_reward
from agents.learning import train as training
from agents.learning.ddpg import MirrorBuffer, Settings, demonstrate, make_agent
from agents.learning.environments import Options, demonstrator_of, fleet, make_env, plant_of, task_of
from agents.learning.evaluate import EvaluationCase, contestants, in_words, run_case, run_together, summary
from agents.learning.train import EPISODE_COLUMNS, Plan, append_row, judge, policy_of, rewrite, train
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.envs.vector_env import FleetVecEnv
from qcar_twin.paths import path_named
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.twin import Twin
from tests.agents.learning.test_train import GOOD, OPTIONS, PLAN, rows

MODEL = Model.nominal()


# -- plants and demonstrators -----------------------------------------------------------------------


def test_a_twin_file_is_what_is_driven(tmp_path):
  twin = Twin(MODEL.vehicle, threads=1)
  theta = twin.parameters.nominal
  theta[twin.parameters.index("mass")] *= 1.1
  save_twin(tmp_path / "twin.toml", twin, theta)
  make, read = plant_of(Options(twin=str(tmp_path / "twin.toml")), MODEL)
  np.testing.assert_array_equal(read, theta)
  assert isinstance(make(), Twin) and make().substeps == Options().substeps
  assert fleet(Options(twin=str(tmp_path / "twin.toml"), estimator="truth"), [0]).config.theta is not None


def test_a_twin_file_that_is_not_there_is_said():
  with pytest.raises(FileNotFoundError, match="calibrate first"):
    plant_of(Options(twin="nowhere.toml"), MODEL)


@pytest.mark.parametrize("name", ["lq_ed", "lq_cm", "ff_fb"])
def test_the_demonstrator_is_the_controller_of_the_file(name):
  options = Options(plant="bicycle", estimator="truth", demonstrator=name, version="tuned", path="o")
  cars = fleet(options, [0, 1], MODEL)
  for _ in range(150):
    cars.step(np.array([0.3, -0.2]))
  errors = cars.errors
  true = dataclasses.replace(errors, **{f.name: getattr(errors, f.name)[1] for f in dataclasses.fields(errors)})
  speed = np.hypot(cars.signals[:, 3], cars.signals[:, 4])
  zero = np.zeros(2)
  wanted = load(MODEL.car)[name, "tuned"].steer(Situation(path_named("o"), zero, true, speed, zero, 0.01))
  np.testing.assert_allclose(cars.expert(), np.clip(wanted, -cars.task.lock, cars.task.lock), rtol=1e-12)
  assert demonstrator_of(dataclasses.replace(options, demonstrator=""), MODEL) is None


def test_a_policy_of_steering_rates_is_no_demonstrator():
  with pytest.raises(ValueError, match="answers nothing to another's driving; demonstrators are .*lq_ed"):
    fleet(Options(plant="bicycle", estimator="truth", demonstrator="linear_rate", version="tuned", path="o"), [0])


def test_the_demonstrators_rate_leads_to_its_angle_where_the_bound_lets_it():
  cars = fleet(Options(plant="bicycle", estimator="truth", version="tuned"), [0, 1, 2], MODEL)
  for _ in range(60):
    wanted, action = cars.expert(), cars.expert_action()
    reached = np.abs(action) < cars.task.largest_rate
    cars.step(action)
    np.testing.assert_allclose(cars.steering[reached], wanted[reached], atol=1e-12)
  assert reached.any()


def test_difference_from_the_demonstrator_is_paid_for():
  options = Options(plant="bicycle", estimator="truth", version="tuned")
  dear = dataclasses.replace(options, reward=dataclasses.replace(options.reward, m6=50.0))
  ends = [fleet(o, [3], MODEL).step(np.array([1.5])).reward[0] for o in (options, dear)]
  same = [
    fleet(dataclasses.replace(o, demonstrator=""), [3], MODEL).step(np.array([1.5])).reward[0] for o in (options, dear)
  ]
  assert ends[1] < ends[0] and same[0] == same[1]


@pytest.mark.parametrize(
  ("field", "value", "reads"),
  [
    ("speed", 0.8, lambda task: task.speed),
    ("start_offset", 0.01, lambda task: task.start_offset),
    ("gain_spread", 0.2, lambda task: task.gain_spread),
    ("steering_gain", 0.9, lambda task: task.steering_gain),
  ],
)
def test_every_option_is_an_argument_of_the_environment(field, value, reads):
  env = make_env(plant="bicycle", estimator="truth", **{field: value})
  assert reads(env.fleet.task) == value
  assert reads(task_of(dataclasses.replace(OPTIONS, **{field: value}))) == value


def test_the_filter_in_the_loop_estimates_what_is_unknown():
  env = make_env(plant="bicycle", unknown=["steering_gain", "speed_scale"])
  settings = env.fleet.config.settings
  assert set(settings.rows) == {"steering_gain", "speed_scale"}


# -- the judge -----------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", ["truth", "fekf"])
def test_the_judge_sees_what_an_evaluation_of_the_training_path_sees(estimator):
  plan = dataclasses.replace(PLAN, options=dataclasses.replace(OPTIONS, estimator=estimator), judges=2)
  case = EvaluationCase(
    OPTIONS.path, "bicycle", OPTIONS.speed, cars=2, seed=training.EVALUATION_SEED, estimator=estimator
  )
  np.testing.assert_allclose(judge(GOOD, plan, MODEL).rmse, kpis(run_case(GOOD, case)).rmse, rtol=1e-9)


def test_a_plant_of_ones_own_is_judged_too():
  asked = []
  make, theta = plant_of(OPTIONS, MODEL)

  def own():
    asked.append(1)
    return make()

  judged = judge(GOOD, PLAN, MODEL, (own, theta))
  assert asked and judged.finished.all()


def test_a_plant_of_another_control_period_is_judged_with_sensors_and_filter_of_its_own():
  options = dataclasses.replace(OPTIONS, estimator="fekf")
  own = partial(Bicycle, MODEL.vehicle, period=0.005), MODEL.theta
  plan = dataclasses.replace(PLAN, options=options, judges=2)
  assert judge(GOOD, plan, MODEL, own).finished.all()
  assert by_reward.judge(GOOD, options, ["random:1:2"], MODEL, own).rmse.max() < 0.05


# -- seeds, tables, logs ---------------------------------------------------------------------------


def test_no_two_cars_trainings_or_resumptions_share_a_seed():
  seeds = [
    seed
    for training_seed in range(4)
    for resumed in range(5)
    for seed in training._seeds(dataclasses.replace(PLAN, seed=training_seed), resumed)
  ]
  assert len(seeds) == len(set(seeds)) == 4 * 5 * PLAN.settings.cars


@settings(max_examples=25, deadline=None)
@given(st.lists(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3), max_size=8))
def test_a_table_rewritten_is_the_table_appended(tmp_path_factory, table):
  folder = tmp_path_factory.mktemp("tables")
  columns = ("a", "b", "c")
  rewrite(folder / "rewritten.csv", columns, [])
  for row in table:
    append_row(folder / "appended.csv", columns, row)
    append_row(folder / "rewritten.csv", columns, row)
  rewrite(folder / "again.csv", columns, table)
  again = (folder / "again.csv").read_bytes()
  assert (folder / "rewritten.csv").read_bytes() == again
  if table:
    assert (folder / "appended.csv").read_bytes() == again
  with open(folder / "again.csv", newline="", encoding="utf-8") as stream:
    read = list(csv.reader(stream))
  assert tuple(read[0]) == columns and len(read) == len(table) + 1
  np.testing.assert_allclose(np.array(read[1:], dtype=float).reshape(-1, 3), np.reshape(table, (-1, 3)), rtol=1e-5)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
  folder = tmp_path_factory.mktemp("wired")
  settings_ = dataclasses.replace(PLAN.settings, episodes=12, algorithm="td3", mirror=True, demonstrations=1)
  plan = dataclasses.replace(PLAN, settings=settings_, every=4)
  return folder, plan, train(plan, folder)


def test_tensorboard_holds_episodes(trained):
  events = EventAccumulator(str(trained[0] / "tensorboard"))
  events.Reload()
  tags = events.Tags()["scalars"]
  assert {"episode/r", "episode/l", "episode/rmse"} <= set(tags)


def test_a_training_with_two_critics_and_a_mirror_is_resumed_and_says_what_it_took(trained, tmp_path):
  folder, plan, result = trained
  assert Plan.from_json(json.loads((folder / "training.json").read_text())) == plan
  assert 0.0 < result["seconds"]["cpu"] and result["seconds"]["learning"] <= result["seconds"]["total"]
  longer = json.loads((folder / "training.json").read_text())
  longer["settings"]["episodes"] = 14
  (folder / "training.json").write_text(json.dumps(longer))
  again = train(plan, folder, resume=True)
  assert again["episodes"] == 14 and again["resumed"] == 1 and again["updates"] > result["updates"]
  assert again["seconds"]["total"] > result["seconds"]["total"]
  table = rows(folder / "episodes.csv")
  assert tuple(table[0]) == EPISODE_COLUMNS and [row["episode"] for row in table] == list(range(1, 15))


def test_a_demonstration_is_in_the_mirror_buffer_before_the_first_update():
  settings_ = Settings(episodes=2, cars=2, steps_per_update=2, warm_up=0, mirror=True, buffer=6000)
  options = dataclasses.replace(OPTIONS, demonstrator="lq_ed", path="s", speed=0.5)
  agent = make_agent(FleetVecEnv(fleet(options, range(2), MODEL)), settings_, 0)
  demonstrate(agent, 1)
  buffer = agent.replay_buffer
  assert isinstance(buffer, MirrorBuffer) and buffer.pos > 1000


def test_a_mirror_that_always_shows_the_right_side_is_a_plain_buffer(monkeypatch):
  options = dataclasses.replace(OPTIONS, demonstrator="lq_ed")
  settings_ = Settings(episodes=2, cars=2, steps_per_update=2, warm_up=0, mirror=True, buffer=6000)
  agent = make_agent(FleetVecEnv(fleet(options, range(2), MODEL)), settings_, 0)
  demonstrate(agent, 1)
  monkeypatch.setattr(np.random, "choice", lambda values, size: np.ones(size, np.float32))
  monkeypatch.setattr(np.random, "randint", lambda low, high, size: np.zeros(size, dtype=np.int64))
  rows_ = np.arange(64)
  seen = agent.replay_buffer._get_samples(rows_)
  plain = ReplayBuffer._get_samples(agent.replay_buffer, rows_)
  for a, b in zip(seen, plain, strict=True):
    if a is not None:
      np.testing.assert_array_equal(a.numpy(), b.numpy())


def test_a_policy_is_named_after_how_it_learnt():
  agent = make_agent(FleetVecEnv(fleet(OPTIONS, range(4), MODEL)), PLAN.settings, 0)
  assert policy_of(agent, PLAN, {}).name == "ddpg"
  imitating = dataclasses.replace(PLAN, settings=dataclasses.replace(PLAN.settings, episodes=0, imitations=1))
  assert policy_of(agent, imitating, {}).name == "imitation"


# -- words ---------------------------------------------------------------------------------------


def test_circumstances_are_said_in_words():
  assert EvaluationCase("o").label == "mujoco, 0.5 m/s"
  bent = EvaluationCase("c", "bicycle", 0.7, 0.92, -1.0)
  assert bent.label == "bicycle, 0.7 m/s, gain 0.92, offset -1 deg"


def test_versions_left_out_are_not_driven():
  assert {name.split()[1] for name in contestants({}, 0.5)} == {"loose", "tuned"}
  assert contestants({}, 0.5, baselines=False) == {}


def test_a_summary_in_words_has_a_line_for_everybody():
  case = EvaluationCase("s", "bicycle", cars=1, estimator="truth")
  members = {"lq_cm tuned": contestants({}, 0.5)["lq_cm tuned"], "net": GOOD}
  text = in_words(summary(run_together(members, case)))
  lines = text.splitlines()
  assert lines[0].startswith("s (bicycle, 0.5 m/s)") and [line.split()[0] for line in lines[1:]] == ["lq_cm", "net"]


@pytest.mark.parametrize(
  ("given", "error", "said"),
  [
    ({"reward": 3}, TypeError, "reward must be a Reward, or a table of its weights"),
    ({"steering_gain": -1.0}, ValueError, "steering_gain -1: a linkage's gain is more than 0"),
    ({"steering_offset": 100.0}, ValueError, "steering_offset 100 deg"),
    ({"start_heading": 4.0}, ValueError, "start_heading 4 rad"),
    ({"start_offset": 1.0}, ValueError, "start_offset 1 m: a car is lost from 0.2 m on"),
    ({"plant": "bicycle", "randomise": "prior"}, ValueError, "the bicycle has none of them"),
    ({"normalised": "no"}, TypeError, "normalised must be True or False"),
    ({"observaton": "wide"}, TypeError, "did you mean observation"),
    ({"path": "S"}, KeyError, "did you mean s"),
  ],
)
def test_options_that_cannot_be_are_refused(given, error, said):
  with pytest.raises(error, match=said):
    make_env(**{"plant": "bicycle", "estimator": "truth"} | given)
