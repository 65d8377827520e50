"""Curves are drawn as departures from the nearest base car, and a form lies on the curve it made."""

import numpy as np
import pytest

from calibration.diagnosis.curves.naming.forms import outlines, projection
from calibration.diagnosis.curves.report.shapes import shapes
from tests.calibration.diagnosis.curves.naming.test_forms import (  # noqa: F401  (a fixture that is used everywhere)
  MADE,
  NOISE,
  REACH,
  characterised,
  heights_of,
  known_covariance,
)


def drawn(heights):
  """The shape of the curve named, of a twin with these heights."""
  found = characterised(heights)
  return next(s for s in shapes(found, outlines(found)) if s.curve == next(iter(heights)))


@pytest.mark.parametrize("form", MADE)
def test_a_form_lies_on_the_curve_it_made(form):
  curve, values = MADE[form]
  shape = drawn({curve: heights_of(curve, {form: values})})
  size = max(np.abs(v.departure).max() for v in shape.views)
  for view in shape.views:
    assert form in view.forms
    # straight lines between a few knots, and the exact form
    assert np.abs(view.forms[form] - view.departure).mean() < 0.15 * size


@pytest.mark.parametrize("curve", ["drive_curve", "resistance_curve"])
def test_what_the_base_car_can_do_itself_is_no_departure(curve):
  blank = characterised({})
  nuisance = projection(blank, blank.fitted.problem.mechanism(curve))[1]
  heights = 0.1 * nuisance[:, 0]
  shape, none = drawn({curve: heights}), drawn({curve: 0.0 * heights})
  law = lambda s: np.concatenate([v.law for v in s.views])
  moved = np.abs(law(shape) - law(none)).max()
  assert max(np.abs(v.departure).max() for v in shape.views) < 0.02 * moved


def test_the_band_is_that_of_the_heights():
  (view,) = drawn({"steering_curve": np.zeros(6)}).views
  reach = np.degrees(REACH["steering_curve_reach"])
  assert view.std[[0, -1]] == pytest.approx(NOISE * reach)  # at a knot, shares of the reach
  assert view.std[len(view.x) // 2] == pytest.approx(0.0, abs=1e-9)  # the middle is held at zero
