"""Slopes that are known serve again where they hold: near their place, and for the same scales."""

import numpy as np
import pytest

from calibration.fitting.slopes import NARROWEST, Slopes
from qcar_twin.parameters import Parameter, ParameterSet

STEP = 0.02


def parameters(typical=2.0) -> ParameterSet:
  return ParameterSet([Parameter(name, 0.0, -9.0, 9.0, "-", typical=typical) for name in "ab"])


def squares(theta):
  return np.concatenate([theta, theta**2], axis=1)


@pytest.fixture
def known() -> Slopes:
  return Slopes()


def taken(known, place, half, residual=squares, p=None):
  theta = np.array(place)
  jacobian = known.at(residual, p or parameters(), theta, residual(theta[None])[0], half, STEP)
  return jacobian, known.evaluations


def test_they_are_taken_once_per_place_and_stencil(known):
  first, spent = taken(known, [1.0, 2.0], 0.1)
  again, nothing = taken(known, [1.0, 2.0], 0.1)
  np.testing.assert_allclose(first, [[1, 0], [0, 1], [2, 0], [0, 4]], atol=1e-12)
  assert again is first and (spent, nothing) == (4, 0)
  assert taken(known, [1.0, 2.0], 0.3)[1] == 4 and taken(known, [1.0, 2.0], 0.0)[1] == 2


@pytest.mark.parametrize("away,spent", [(0.019, 0), (0.021, 4)])
def test_they_serve_within_a_tenth_of_their_stencil(known, away, spent):
  taken(known, [1.0, 2.0], 0.1)
  assert taken(known, [1.0, 2.0 + away], 0.1)[1] == spent


def test_a_constant_added_to_the_residual_leaves_them(known):
  before, _ = taken(known, [1.0, 2.0], 0.1)
  after, spent = taken(known, [1.0, 2.0], 0.1, lambda theta: squares(theta) + 5.0)
  assert after is before and spent == 0


def test_the_narrowest_central_ones_serve_for_forward_ones(known):
  central, _ = taken(known, [1.0, 2.0], NARROWEST)
  forward, spent = taken(known, [1.0, 2.0], 0.0)
  assert forward is central and spent == 0


def test_other_scales_or_a_residual_that_was_changed_ask_for_new_ones(known):
  taken(known, [1.0, 2.0], 0.1)
  assert taken(known, [1.0, 2.0], 0.1, p=parameters(3.0))[1] == 4
  known.forget()
  assert taken(known, [1.0, 2.0], 0.1, p=parameters(3.0))[1] == 4
