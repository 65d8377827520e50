"""Timings: parts sum up to the whole, watching leaves nothing behind, speeds are speeds."""

import json
import runpy
from pathlib import Path

import pytest

from agents import timing
from agents.environments import Options, fleet
from agents.timing import Watch, gradient_steps_per_second, raw_gradient_steps_per_second, steps_per_second, watching

ROOT = Path(__file__).resolve().parents[2]


def test_parts_of_a_training_sum_up_to_it():
  shares = timing.training_shares(400)
  total, steps = shares.pop("total"), shares.pop("steps")
  assert set(shares) == {"physics", "sensors and filter", "networks", "rest"} and steps == 400.0
  assert sum(shares.values()) == pytest.approx(total)
  assert all(seconds > 0.0 for seconds in shares.values())


def test_watching_leaves_a_fleet_as_it_was():
  cars = fleet(Options(plant="bicycle", estimator="truth"), [0])
  with watching(cars) as parts:
    cars.step([0.0])
    assert "step" in vars(cars._bodies)
  assert "step" not in vars(cars._bodies) and "observe" not in vars(cars._observer)
  assert parts["physics"].seconds > 0.0
  before = parts["physics"].seconds
  cars.step([0.0])
  assert parts["physics"].seconds == before


def test_a_watch_counts_what_fails_too():
  watch = Watch()
  with pytest.raises(ZeroDivisionError):
    watch.around(lambda x: sum(range(20000)) / x)(0)
  assert watch.seconds > 0.0


def test_many_cars_share_what_a_step_costs():
  assert steps_per_second(16, 30, "truth") > 1.5 * steps_per_second(1, 60, "truth")


def test_gradient_steps_are_counted_for_both_agents():
  assert gradient_steps_per_second(20, 16) > 10.0 and raw_gradient_steps_per_second(20, 16) > 10.0


def test_script_writes_a_sentence_per_measurement(tmp_path, monkeypatch, capsys):
  monkeypatch.setattr(timing, "steps_per_second", lambda *_: 1000.0)
  made = runpy.run_path(str(ROOT / "scripts" / "benchmark_learning.py"))
  found = made["main"](made["Config"](tmp_path / "timings.json", steps=800, quick=True))
  assert json.loads((tmp_path / "timings.json").read_text()) == found
  assert any("1000 us per 10 ms" in line for line in found) and "gradient steps" in capsys.readouterr().out
