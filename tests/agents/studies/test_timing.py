"""Timings: parts sum up to the whole, watching leaves nothing behind, speeds are speeds."""

import pytest

from agents.learning.environments import Options, fleet
from agents.studies import timing
from agents.studies.timing import (
  Watch,
  gradient_steps_per_second,
  raw_gradient_steps_per_second,
  steps_per_second,
  watching,
)
from tests.counting import ticking


def test_parts_of_a_training_sum_up_to_it():
  shares = timing.training_shares(400)
  total, steps = shares.pop("total"), shares.pop("steps")
  assert set(shares) == {"physics", "sensors and filter", "networks", "rest"} and steps == 400.0
  assert sum(shares.values()) == pytest.approx(total)
  assert all(seconds > 0.0 for seconds in shares.values())


def test_parts_of_an_environment_of_many_cars_sum_up_to_it():
  shares = timing.batch_shares(3, 30)
  total = shares.pop("total")
  assert shares.pop("steps") == 90.0 and sum(shares.values()) == pytest.approx(total)
  assert all(shares[name] > 0.0 for name in ("physics", "sensors", "filter", "path", "observation", "rest"))


def test_watching_leaves_a_fleet_as_it_was():
  cars = fleet(Options(plant="bicycle", estimator="truth"), [0])
  with watching(cars) as parts:
    cars.step([0.0])
    assert "step" in vars(cars.cars.plant)
  assert "step" not in vars(cars.cars.plant) and "observe" not in vars(cars.cars.observer)
  assert parts["physics"].seconds > 0.0
  before = parts["physics"].seconds
  cars.step([0.0])
  assert parts["physics"].seconds == before


def test_a_watch_counts_what_fails_too():
  watch = Watch()
  with pytest.raises(ZeroDivisionError):
    watch.around(lambda x: sum(range(20000)) / x)(0)
  assert watch.seconds > 0.0


def test_speeds_count_the_steps_of_all_cars(monkeypatch):
  monkeypatch.setattr(timing, "time", ticking())
  assert steps_per_second(16, 5, "truth") == 80.0 and steps_per_second(1, 5, "truth") == 5.0


def test_gradient_steps_are_counted_for_both_agents(monkeypatch):
  monkeypatch.setattr(timing, "time", ticking())
  assert gradient_steps_per_second(3, 16) == raw_gradient_steps_per_second(3, 16) == 3.0
