"""The commands of the agents, run as a user would with --quick."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from agents.learning import evaluate as evaluation
from agents.learning.policy_file import SHIPPED, load_policy, save_policy
from agents.studies.study import plan_from
from qcar_twin.rendering.film import RenderingUnavailable
from qcar_twin.tracks import random_track
from qcar_twin.twin import Twin, save_twin
from qcar_twin.vehicle import Vehicle
from scripts import evaluate, render, train
from tests import ROOT
from tests.agents.learning.test_train import GOOD


def test_evaluate_writes_results_and_figures(tmp_path, capsys, monkeypatch):
  monkeypatch.setattr(evaluation, "path_from", lambda name: random_track(1, 2.0))
  save_policy(GOOD, tmp_path / "policy")
  evaluate.main(evaluate.Config(tmp_path / "out", policy=(tmp_path / "policy",), plants=("bicycle",), quick=True))
  assert f"{GOOD.name}: number of updates by reward unknown; sees 4 numbers" in capsys.readouterr().out
  summary = json.loads((tmp_path / "out" / "evaluation.json").read_text())["summary"]
  assert {entry["path"] for entry in summary} == {"s"} and len(summary) == 5
  names = {p.name for p in (tmp_path / "out").iterdir()}
  assert {"indicators_0.png", "tracking_s.png", "evaluation.txt"} <= names


def test_proving_ground_drives_with_the_effects_asked_for():
  plain, bent = evaluate.ground(()), evaluate.ground(("steering_offset=1.0",))
  start = [[0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0]]
  ends = []
  for ground in (plain, bent):
    simulation = ground.begin(None, start)
    for _ in range(100):
      signals = simulation.step([[0.8, 0.0]])
    ends.append(signals[0, 2])
  assert abs(ends[0]) < 0.01 < abs(ends[1])


def test_effects_that_no_car_would_have_are_refused(tmp_path):
  with pytest.raises(ValueError, match="--effects are of the independent car: add --plants proving_ground"):
    evaluate.main(evaluate.Config(tmp_path, effects=("steering_offset=1",), plants=("bicycle",), quick=True))
  with pytest.raises(ValueError, match="effect 'steering_offset=much' needs a number of typical sizes"):
    evaluate.ground(("steering_offset=much",))


@pytest.mark.parametrize("what", ["drive", "recording"])
def test_render_makes_a_film_and_a_still(tmp_path, what):
  save_policy(GOOD, tmp_path / "policy")
  choice = {"policy": tmp_path / "policy", "path": "random:1:2", "plant": "bicycle", "ghost": "lq_cm tuned"}
  if what == "recording":
    choice = {"dataset": ROOT / "data" / "sample", "recording": "figure_eight"}
  try:
    render.main(render.Config(tmp_path / "film.mp4", quick=True, **choice))
  except RenderingUnavailable as error:
    pytest.skip(str(error))
  assert (tmp_path / "film.mp4").stat().st_size > 5000 and (tmp_path / "film.png").stat().st_size > 2000


def test_a_filmed_twin_is_driven_with_the_timing_of_its_file(tmp_path):
  car, moved = Twin(Vehicle.load(), threads=1), []
  for shift in (0, 3):
    save_twin(tmp_path / "twin.toml", car, car.parameters.nominal, command_shift=shift)
    config = render.Config(tmp_path / "film.mp4", recording="figure_eight", twin=tmp_path / "twin.toml")
    moved.append(render.recorded(config, ROOT / "data" / "sample")[1])
  assert np.abs(moved[1] - moved[0]).max() > 0.01


def test_a_recording_is_filmed_with_its_own_car(tmp_path, monkeypatch):
  shutil.copytree(ROOT / "data" / "sample", tmp_path / "long")
  toml = tmp_path / "long" / "dataset.toml"
  text = toml.read_text(encoding="utf-8").replace("cg_to_front = 0.116607", "cg_to_front = 0.16")
  toml.write_text(text.replace("cg_to_rear = 0.139447", "cg_to_rear = 0.14"), encoding="utf-8")

  def film(path, vehicle, **_):
    raise StopIteration(vehicle.wheelbase)

  monkeypatch.setattr(render, "Film", film)
  with pytest.raises(StopIteration, match="0.3"):
    render.main(render.Config(tmp_path / "film.mp4", dataset=tmp_path / "long", recording="figure_eight"))


def test_render_names_who_could_drive(tmp_path):
  with pytest.raises(ValueError, match="lq_cm tuned"):
    render.main(render.Config(tmp_path / "film.mp4", driver="lqr", plant="bicycle"))


def planned(folder, **asked):
  return plan_from(vars(train.Config(folder, **asked)), {f.name: f.default for f in dataclasses.fields(train.Config)})


def test_train_asks_for_what_was_said(tmp_path):
  plan = planned(tmp_path, demonstrator="none", near=0.005, steering_gain=0.92, seed=7)
  assert plan.options.demonstrator == "" and plan.options.reward.m6 == 0.0 and plan.options.reward.near == 0.005
  assert plan.options.steering_gain == 0.92 and plan.seed == 7 and plan.settings.episodes == 300
  assert planned(tmp_path).options.reward.m6 == 1.0
  wide = planned(tmp_path, wide=True, seed=2, twin="x.toml")
  assert wide.observation.size == 9 and wide.settings.imitations > 0 and (wide.seed, wide.options.twin) == (2, "x.toml")


def test_an_imitation_is_of_the_path_and_the_car_that_were_said_and_what_it_cannot_take_is_refused(tmp_path):
  plan = planned(tmp_path, wide=True, path="o", estimator="truth", steering_gain=0.9, randomise="prior", cars=4)
  options = plan.options
  assert (options.path, options.estimator, options.steering_gain, options.randomise) == ("o", "truth", 0.9, "prior")
  assert plan.settings.cars == 4 and options.gain_spread == 0.1
  for kind, wrong in (({"wide": True}, {"episodes": 9}), ({"wide": True}, {"workers": 4}), ({}, {"critic": "truth"})):
    with pytest.raises(ValueError, match=f"has no use for --{next(iter(wrong))}: leave it out, or"):
      planned(tmp_path, **kind, **wrong)


def test_the_shipped_policy_says_where_it_comes_from_and_stays_on_the_s_path():
  from agents.control.kpis import kpis
  from agents.learning.evaluate import EvaluationCase, run_case

  policy = load_policy(SHIPPED)
  assert policy.provenance["training"]["options"]["path"].startswith("random:")
  indicators = kpis(run_case(policy, EvaluationCase("s", cars=2)))
  assert indicators.finished.all() and indicators.rmse.max() < 0.015
