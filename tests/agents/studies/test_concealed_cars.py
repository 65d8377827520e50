"""Agents on cars that conceal an effect: what is driven with which filter, gaps and their medians."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from agents.control.external_plant import ExternalPlant
from agents.learning.evaluate import EvaluationCase
from agents.learning.hyperparameters import read_hyperparameters
from agents.learning.policy_file import save_policy
from agents.learning.trial import quickly
from agents.studies import concealed_cars
from agents.studies.concealed_cars import (
  Driven,
  drive_car,
  in_markdown,
  median_interval,
  own_options,
  read_car,
  train_agent,
)
from calibration.concealed.campaign.cases import draw_steering_cases
from calibration.concealed.campaign.run import drivable
from calibration.concealed.proving_ground.effects import EFFECTS
from qcar_twin.twin.mechanisms import catalogue
from tests.agents.learning.test_train import GOOD

HYPER = quickly(dataclasses.replace(read_hyperparameters("ppo"), cars=4))


class Standing:
  """Cars that stand."""

  def __init__(self, count):
    self.signals = np.zeros((count, 10))


def car(gap, closed, null=False):
  """Recalibrated 5 + gap mm, reference 5 mm, everybody else so much of it; streams differ by 0.1 mm alike."""
  noise = 1e-4 * np.arange(8.0)
  shaped = lambda mm: np.full((1, 3, 8), 1e-3 * mm) + noise
  table = {name: shaped(5.0 + gap * (1.0 - closed)) for name in concealed_cars.ABOUT}
  table |= {"recalibrated": shaped(5.0 + gap) + 1e-4 * np.sin(np.arange(8)), concealed_cars.REFERENCE: shaped(5.0)}
  return Driven("a car", null, "said", table)


def test_a_gap_is_one_where_its_interval_is_above_zero():
  wide, none = car(2.0, 0.6), car(0.0, 0.0)
  assert wide.has_gap and not none.has_gap
  assert wide.closed("repaired") == pytest.approx(0.6, abs=0.02)
  assert wide.closed("recalibrated") == 0.0


def test_the_tables_hold_every_car_and_count_those_with_a_gap():
  text = in_markdown([car(2.0, 0.5), car(3.0, 0.7), car(0.0, 0.0), car(0.0, 0.0, null=True), car(0.0, 0.0, null=True)])
  assert "on the 2 cars that have one" in text and "* repaired: median 60 %" in text
  assert "3 cars that conceal an effect" in text and "2 cars that conceal nothing" in text
  assert text.count("| a car |") == 5 and text.count("**+") == 2
  assert "on the 0 cars" in in_markdown([car(0.0, 0.0)])


@pytest.mark.parametrize(("count", "rank"), [(3, 0), (6, 0), (8, 0), (9, 1), (12, 2), (20, 5)])
def test_a_medians_interval_is_of_order_statistics(count, rank):
  middle, low, high = median_interval(range(count))
  assert middle == (count - 1) / 2 and (low, high) == (rank, count - 1 - rank)


def test_cars_conceal_what_lies_between_command_and_wheels():
  for kind in ("first", "second"):
    cases = draw_steering_cases(1, 30, kind)
    assert cases == draw_steering_cases(1, 30, kind) and len({c.seed for c in cases}) == 30
    assert [not c.effects for c in cases] == [i % 5 == 4 for i in range(30)]
    named = {name for c in cases for name, _ in c.effects}
    assert named <= set(catalogue()) and all(catalogue()[n].subsystem == "steering" for n in named)
    assert {size for c in cases for _, size in c.effects} == {1.0, 2.0}
  assert "steering_delay" in EFFECTS


@pytest.mark.parametrize("kind", ["first", "second"])
def test_a_case_can_be_driven_with_its_effect_and_without(kind):
  case = next(c for c in draw_steering_cases(1, 12, kind) if c.effects and c.effects[0][0] == "steering_offset")
  ends = []
  for effect in (True, False):
    simulation = drivable(case, effect).begin(np.array([[0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0]]))
    for _ in range(60):
      signals = simulation.step(np.array([[0.8, 0.0]]))
    ends.append(signals[0, 2])
  assert abs(ends[0] - ends[1]) > 0.01


def test_everybody_drives_with_what_its_filter_knows_and_is_not_driven_twice(tmp_path, monkeypatch):
  for name in ("a", "b"):
    save_policy(GOOD, tmp_path / name)
  seen = []

  def together(drivers, case, plant):
    cars = plant("")[0]
    cars.begin(np.empty((1, 0)), np.zeros((1, 7)))
    seen.append((tuple(drivers), case.known_from, case.path, cars.period))
    rows = []
    for i, label in enumerate(drivers):
      scores = SimpleNamespace(rmse=np.array([1e-3 * (i + 1), np.inf]))
      rows.append(SimpleNamespace(contestant=label, kpis=scores))
    return rows

  monkeypatch.setattr(concealed_cars, "run_together", together)
  policies = {"nominal": [tmp_path / "a", tmp_path / "b"], "repaired": [tmp_path / "a"], "posterior": [tmp_path / "b"]}
  begun = []
  bad, good = (ExternalPlant(lambda start: begun.append(len(start)) or Standing(len(start)), p) for p in (0.01, 0.02))
  file = tmp_path / "driven.json"
  kept = drive_car(policies, tmp_path, {True: bad, False: good}, 2, {"linear_rate": GOOD}, file)
  assert {(names, told, period == 0.01) for names, told, _, period in seen} == {
    (("nominal 0", "nominal 1", "linear_rate 0"), "", True),
    (("without the effect 0", "without the effect 1"), "", False),
    (
      ("nominal, informed 0", "nominal, informed 1", "repaired 0", "posterior 0", "linear_rate, informed 0"),
      str(tmp_path / "twin.toml"),
      True,
    ),
  }
  assert sorted(begun) == [3, 6]  # a car of each path and filter, all in one simulation
  assert np.shape(kept["nominal"]) == (2, 3, 2) and np.shape(kept["linear_rate"]) == (1, 3, 2)
  assert kept["nominal"][1][0][0] == 0.002 and kept["nominal"][0][2][1] == concealed_cars.LEFT
  assert kept["repaired"][0][0][0] == kept["repaired"][0][2][0] == 0.003 and np.shape(kept["repaired"]) == (1, 3, 2)
  seen.clear()
  assert drive_car({}, tmp_path, {}, 2, {}, file) == json.loads(file.read_text()) and not seen
  assert read_car("x", True, "", file).mean("nominal").shape == (2,)


def test_an_agent_is_trained_once_in_the_environment_of_its_name(tmp_path, monkeypatch):
  asked = []

  def trained(trial, folder, tensorboard):
    asked.append(trial)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text("{}", encoding="utf-8")

  monkeypatch.setattr(concealed_cars, "train_by_reward", trained)
  (tmp_path / "recalibrated.toml").write_text('note = "before"\nmass = 2.0\n')
  (tmp_path / "twin.toml").write_text('note = "after"\nmass = 2.0\n')
  unrepaired = own_options(tmp_path)
  assert unrepaired["repaired"] == unrepaired["recalibrated"] != unrepaired["posterior"]
  (tmp_path / "twin.toml").write_text('note = "after"\nmass = 2.5\n')
  changes = {**concealed_cars.ONCE, **own_options(tmp_path)}
  for name, what in changes.items():
    for _ in range(2):
      assert train_agent(HYPER, what, 3, tmp_path / name) == tmp_path / name / "best"
  assert len(asked) == len(changes) and all(trial.options.unknown and trial.seed == 3 for trial in asked)
  by_name = dict(zip(changes, asked, strict=True))
  assert by_name["bicycle"].options.plant == "bicycle" and by_name["randomised"].options.randomise == "prior"
  assert by_name["posterior"].options.diagnosis == str(tmp_path) and by_name["posterior"].options.informed
  assert by_name["repaired"].options.twin.endswith("twin.toml") and not by_name["nominal"].options.informed


def test_a_case_says_whence_the_filter_knows():
  assert "known from x/twin.toml" in EvaluationCase("o", known_from="x/twin.toml").label
