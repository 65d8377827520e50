"""Slopes that are known serve again where they hold, and are taken where the posterior lies."""

import numpy as np
import pytest

from calibration.fitting.slopes import WIDEST, Slopes
from qcar_twin.parameters import Parameter, ParameterSet

STEP = 0.02


def parameters() -> ParameterSet:
  return ParameterSet([Parameter(name, 0.0, -9.0, 9.0, "-", typical=2.0) for name in "ab"])


def squares(theta):
  return np.concatenate([theta, theta**2], axis=1)


@pytest.fixture
def known() -> Slopes:
  return Slopes()


def taken(known, place, stencil, residual=squares):
  theta = np.array(place)
  jacobian = known.at(residual, parameters(), theta, residual(theta[None])[0], stencil, STEP)
  return jacobian, known.evaluations


def test_they_are_taken_once_per_place_and_stencil(known):
  first, spent = taken(known, [1.0, 2.0], 0.1)
  again, nothing = taken(known, [1.0, 2.0], 0.1)
  np.testing.assert_allclose(first, [[1, 0], [0, 1], [2, 0], [0, 4]], atol=1e-12)
  assert again is first and (spent, nothing) == (4, 0)
  assert taken(known, [1.0, 2.0], 0.3)[1] == 4 and taken(known, [1.0, 2.0], "forward")[1] == 2


@pytest.mark.parametrize("away,spent", [(0.019, 0), (0.021, 4)])
def test_they_serve_within_a_tenth_of_their_stencil(known, away, spent):
  taken(known, [1.0, 2.0], 0.1)
  assert taken(known, [1.0, 2.0 + away], 0.1)[1] == spent


def test_a_constant_added_to_the_residual_leaves_them(known):
  before, _ = taken(known, [1.0, 2.0], 0.1)
  after, spent = taken(known, [1.0, 2.0], 0.1, lambda theta: squares(theta) + 5.0)
  assert after is before and spent == 0


def test_a_deviation_wide_they_are_central_and_serve_for_forward_ones(known):
  """A parameter's own deviation, all others held, read off forward differences first; the widest where not known."""
  steep = lambda theta: theta * [20.0, 1e-6]
  central, spent = taken(known, [1.0, 2.0], "deviation", steep)
  assert spent == 2 + 4
  np.testing.assert_allclose(central, np.diag([20.0, 1e-6]), rtol=1e-6)
  np.testing.assert_allclose(known.widths, [1 / 20.0, WIDEST * 2.0], rtol=1e-3)
  forward, spent = taken(known, [1.0, 2.0], "forward", steep)
  assert forward is central and spent == 0


def test_a_prior_narrows_a_deviation(known):
  p = ParameterSet([Parameter("a", 0.0, -9.0, 9.0, "-", std=0.1)])
  known.at(lambda theta: 50.0 * theta, p, np.zeros(1), np.zeros(1), "deviation")
  assert known.widths == pytest.approx([2600.0**-0.5])


def test_a_residual_that_was_changed_asks_for_new_ones(known):
  taken(known, [1.0, 2.0], 0.1)
  known.forget()
  assert taken(known, [1.0, 2.0], 0.1)[1] == 4


def test_other_weights_of_the_same_residual_have_the_same_slopes_weighed(known):
  weights = np.array([2.0, 1.0, 0.5, 3.0])
  before, _ = taken(known, [1.0, 2.0], 0.1)
  weighed = lambda theta: squares(theta) * weights
  after, spent = taken(known.weighed(weights), [1.0, 2.0], 0.1, weighed)
  np.testing.assert_allclose(after, before * weights[:, None])
  assert spent == 0 and taken(known, [1.0, 2.0], 0.1)[0] is before
