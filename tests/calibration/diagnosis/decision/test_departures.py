"""Figures that the driving contradicts, against measurement and the twin's own form."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.decision.departures import departures, needed
from calibration.diagnosis.decision.evidence import Measured
from calibration.diagnosis.decision.levels import usual_levels

LEVELS = usual_levels()
FORMS = {"servo_time_constant": 0.04, "mass": 0.01, "others": 0.1}


def figure(name, value, measured=1.0, std=0.01):
  return Measured(name, measured, std, value, abs(measured) or 0.05, "s")


def test_a_figure_departs_by_measurement_and_form_together():
  one = departures([figure("mass", 1.06)], LEVELS, FORMS)
  assert [d.name for d in one] == ["mass"] and one[0].z == pytest.approx(0.06 / np.hypot(0.01, 0.01))
  assert not departures([figure("servo_time_constant", 1.06)], LEVELS, FORMS)  # 1.5 deviations
  assert not departures([figure("cg_to_front", 1.2)], LEVELS, FORMS)  # of the others


def test_the_farthest_comes_first_whatever_the_order():
  figures = [figure("mass", 1.08), figure("servo_time_constant", 0.5), figure("yaw_inertia", 1.1)]
  for order in (figures, figures[::-1]):
    assert [d.name for d in departures(order, LEVELS, FORMS)] == ["servo_time_constant", "mass"]


def test_the_share_of_a_distance_is_of_what_it_is_a_distance_from():
  height = Measured("cg_height_offset", 0.0, 0.001, 0.04, 0.06, "m")
  (found,) = departures([height], LEVELS, FORMS)
  assert found.z == pytest.approx(0.04 / np.hypot(0.001, 0.1 * 0.06))


def test_by_chance_any_of_many_figures_departs_as_seldom_as_stated():
  random, count, hits = np.random.default_rng(2), 4000, 0
  for _ in range(count):
    figures = [figure(n, 1.0 + np.hypot(0.01, FORMS.get(n, 0.1)) * random.normal()) for n in ("mass", "a", "b", "c")]
    hits += bool(departures(figures, LEVELS, FORMS))
  assert hits / count == pytest.approx(LEVELS.conflict, abs=0.007)


@pytest.mark.parametrize(("drop", "told"), [(50.0, True), (0.5, False), (-1.0, False)])
def test_an_unusual_age_is_told_where_a_usual_one_fits_worse_and_not_where_others_make_up_for_it(drop, told):
  age = Measured("pose_latency", 0.0, 0.005, 0.03, 0.01, "s", usual=True)
  row = SimpleNamespace(estimates=[SimpleNamespace(name="pose_latency")], held_out=SimpleNamespace(drop=drop))
  model = SimpleNamespace(measured=(age, figure("mass", 1.5)), sensors=[row])
  late, mass = sorted(departures(model.measured, LEVELS, FORMS), key=lambda d: d.name, reverse=True)
  assert needed(late, model, LEVELS) is told and needed(mass, model, LEVELS)
  assert needed(late, SimpleNamespace(measured=(age,), sensors=[]), LEVELS)
