"""A limit that a fit has left, and that has no slope where it is not reached, is found again."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.fitting.first_guess import where_limits_act
from qcar_twin.parameters import Parameter, ParameterSet

NEEDED = 0.2  # s/rad, from which on the limit is reached


def servo(explained: float) -> tuple[SimpleNamespace, ParameterSet]:
  """Residuals of a servo whose limit takes `explained` off one of them where it is reached, and nothing below."""
  base = ParameterSet(
    [
      Parameter("lag", 0.05, 0.0, 1.0, "s", "tau", std=0.5, description="lag"),
      Parameter("limit", 0.0, 0.0, 0.3, "s/rad", "q", null=0.0, std=0.1, start=0.1, description="limit"),
    ]
  )

  def residual(theta: np.ndarray) -> np.ndarray:
    left = 10.0 - explained * (theta[:, 1] > NEEDED)
    return np.column_stack([left, np.where(theta[:, 1] > 0.28, np.nan, 0.0)])

  return SimpleNamespace(parameters=base, embed=lambda names, theta, around: theta, fitted_residual=residual), base


def test_a_limit_without_a_slope_goes_where_it_explains_most():
  problem, base = servo(6.0)
  begun = where_limits_act(problem, base, np.array([0.05, 0.0]), 1.0)
  assert begun is not None and begun[0] == 0.05
  assert begun[1] == pytest.approx(0.225)  # the first of eight beyond what is needed: the prior; no failed simulation


def test_a_limit_that_is_not_worth_its_prior_stays_where_it_is():
  problem, base = servo(0.2)
  assert where_limits_act(problem, base, np.array([0.05, 0.0]), 1.0) is None
