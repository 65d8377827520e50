"""Equal cars are not accused, the odd one is, at the level of estimates with their covariance."""

import numpy as np
import pytest

from calibration.concealed.benchmarks.fleet import ODD, PLACE, car_name, drawn_fleet
from calibration.fleet.hierarchy import LEVEL, Reading, compare, moderation, spreads


def accused(readings):
  return {(c.unit, c.parameter) for c in compare(readings) if c.accused}


def test_fleets_of_six_equal_cars_accuse_nobody():
  assert sum(bool(accused(drawn_fleet(seed))) for seed in range(20)) == 0


def test_over_many_fleets_the_stated_level_holds():
  wrong = sum(bool(accused(drawn_fleet(1000 + seed))) for seed in range(200))
  assert wrong <= 200 * LEVEL


def test_the_odd_car_and_its_parameter_are_named():
  right = sum(accused(drawn_fleet(seed, odd=0.2)) == {(car_name(ODD), f"p{PLACE}")} for seed in range(40))
  assert right >= 36


def test_deviations_half_too_small_accuse_few():
  assert sum(bool(accused(drawn_fleet(seed, understated=1.5))) for seed in range(40)) <= 10


def test_an_odd_day_is_named_and_no_car_for_it():
  random = np.random.default_rng(1)
  made = []
  for car in "abcd":
    for day in range(5):
      shift = -0.2 if day == 2 else 0.0
      made.append(Reading(car, f"day {day}", {"grip": (1.0 + shift + 0.02 * random.standard_normal(), 0.02)}))
  assert accused(made) == {("day 2", "grip")}


def test_two_cars_differ_and_nobody_is_odd():
  made = [Reading(car, "day", {"grip": (value, 0.01)}) for car, value in (("a", 1.0), ("b", 2.0))]
  assert compare(made) == []


def test_scatters_of_chance_alone_are_wholly_moderated():
  random = np.random.default_rng(3)
  freedom = np.full(4000, 4.0)
  prior, typical = moderation(random.chisquare(4, 4000) / 4.0, freedom)
  assert prior > 100.0 and typical == pytest.approx(1.0, rel=0.05)
  prior, _ = moderation(random.chisquare(4, 4000) / 4.0 * 6.0 / random.chisquare(6, 4000), freedom)
  assert prior == pytest.approx(6.0, rel=0.2)


def test_spread_beyond_what_is_stated_is_read():
  random = np.random.default_rng(2)
  made = [Reading("a", "d", {"mass": (1.0 + 0.05 * random.standard_normal(), 0.01)}) for _ in range(400)]
  (one,) = spreads(made)
  assert one.between == pytest.approx(np.sqrt(0.05**2 - 0.01**2), rel=0.15) and one.stated == pytest.approx(0.01)
