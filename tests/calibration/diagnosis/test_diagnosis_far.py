"""Large effects are tried before recalibration: fitted where they explain much, left alone elsewhere."""

import diagnosis_rig as rig
import pytest
from numpy.testing import assert_allclose

from calibration.diagnosis import far
from calibration.diagnosis.far import FAR, far_models
from qcar_twin.mechanisms import catalogue


def test_delays_and_lags_of_the_catalogue_are_tried():
  assert set(FAR) <= set(catalogue())
  assert all(catalogue()[name].parameters[0].null == 0.0 for name in FAR)


def test_a_large_effect_is_fitted_to_its_minimum(offset_pool, monkeypatch):
  monkeypatch.setattr(far, "FAR", ("steering_offset", "side_force"))
  found = far_models(offset_pool.problem, offset_pool.base, rig.BASE, ["steering_offset", "side_force"])
  model = next(m for m in found if m.mechanisms == ("steering_offset",))
  exact = offset_pool.models[frozenset(["steering_offset"])]
  assert_allclose(model.values, exact.values, rtol=1e-3)
  assert model.cost == pytest.approx(exact.cost, rel=1e-6)


def test_nothing_is_fitted_where_nothing_is_gained(clean_pool, monkeypatch):
  monkeypatch.setattr(far, "FAR", ("steering_offset", "side_force"))
  assert far_models(clean_pool.problem, clean_pool.base, rig.BASE, ["steering_offset", "side_force"]) == []


def test_what_is_not_considered_is_not_tried(offset_pool, monkeypatch):
  monkeypatch.setattr(far, "FAR", ("steering_offset",))
  assert far_models(offset_pool.problem, offset_pool.base, rig.BASE, ["side_force"]) == []
