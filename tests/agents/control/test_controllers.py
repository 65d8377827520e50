"""The catalogue of controllers, its file, and the fair search."""

import dataclasses

import numpy as np
import pytest

from agents.control import controllers
from agents.control.controllers import FAMILIES, VERSIONS, entries, load, make, save, side_by_side
from agents.control.tuning import Search, tune
from qcar_twin.estimation.settings import FilterSettings
from tests.agents.control.test_lq import situation
from tests.agents.control.tracking_rig import CAR, PLANT, THETA

NUMBERS = {name: dict(zip(family.numbers, family.start, strict=True)) for name, family in FAMILIES.items()}


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_makes_a_controller_that_steers_back(name):
  controller = make(name, NUMBERS[name], CAR, 0.5)
  assert controller.name == name
  left, right = controller.steer(situation([[0.05, 0, 0, 0], [-0.05, 0, 0, 0]]))
  assert left < 0.0 < right and left == pytest.approx(-right)


def test_a_misspelt_controller_or_version_is_answered_with_the_nearest():
  with pytest.raises(ValueError, match="^no controller 'lqcm'; did you mean 'lq_cm'?"):
    controllers.entry("lqcm", "tuned")
  with pytest.raises(ValueError, match="^no version 'tunned' of controller 'lq_cm'; did you mean 'tuned'?"):
    controllers.entry("lq_cm", "tunned")


@pytest.mark.parametrize("name", FAMILIES)
def test_side_by_side_is_one_after_the_other(name):
  stronger = {key: 1.5 * value for key, value in NUMBERS[name].items()}
  pair = [make(name, numbers, CAR, 0.5) for numbers in (NUMBERS[name], stronger)]
  rng = np.random.default_rng(0)
  x = 0.02 * rng.normal(size=(6, 4))
  together = side_by_side(pair, 3).steer(situation(x, curvature=0.4))
  for i, controller in enumerate(pair):
    np.testing.assert_allclose(
      together[3 * i : 3 * i + 3], controller.steer(situation(x[3 * i : 3 * i + 3], curvature=0.4)), atol=1e-12
    )


def test_file_round_trip(tmp_path):
  file = tmp_path / "controllers.toml"
  table = {name: {"tuned": {**numbers, "note": 'said "so"'}} for name, numbers in NUMBERS.items()}
  save(table, file)
  assert entries(file)["ff_fb"]["tuned"]["note"] == 'said "so"'
  assert entries(file)["lq_ed"]["tuned"]["effort"] == pytest.approx(NUMBERS["lq_ed"]["effort"])
  loaded = load(CAR, 0.5, file)
  assert set(loaded) == {(name, "tuned") for name in FAMILIES}
  assert not list(tmp_path.glob(".writing-*"))


def test_the_projects_file_holds_a_loose_and_a_tuned_version_of_each_with_their_origin():
  table = entries()
  assert set(table) == set(FAMILIES)
  for name, versions in table.items():
    assert set(versions) == set(VERSIONS)
    for entry in versions.values():
      assert set(FAMILIES[name].numbers) <= set(entry) and len(entry["origin"]) > 20
  assert len(load(CAR)) == 8


def test_missing_file_names_the_cure(tmp_path):
  with pytest.raises(FileNotFoundError, match=r"run qcar-twin tune"):
    load(CAR, 0.5, tmp_path / "none.toml")


def test_unknown_controller_and_missing_number():
  with pytest.raises(KeyError, match="did you mean lq_ed"):
    make("lq_de", {}, CAR, 0.5)
  with pytest.raises(KeyError, match="lacks the numbers preview"):
    make("ff_fb", {"gain": 1.0}, CAR, 0.5)


def test_a_short_search_improves_on_its_start_and_keeps_to_the_cap():
  search = Search(candidates=5, elite=2, generations=2, seed=3, path="random:1:2", speed=1.0)
  begin = dataclasses.replace(search, candidates=1, elite=1, generations=0)
  family = FAMILIES["ff_fb"]
  first = tune(family, PLANT, THETA, CAR, FilterSettings(steering_lag=0.05), begin)
  best = tune(family, PLANT, THETA, CAR, FilterSettings(steering_lag=0.05), search)
  assert first.numbers == pytest.approx(dict(zip(family.numbers, family.start, strict=True)))
  assert best.rmse < first.rmse and best.steering_rate < search.rate_cap
  assert controllers.FILE.name == "controllers.toml"
