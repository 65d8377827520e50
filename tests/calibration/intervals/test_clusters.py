"""Deviations of a fit whose samples share disturbances, against many drawn data sets."""

import numpy as np
import pytest

from calibration.fitting.optimiser import fit
from calibration.intervals.clusters import fitted_std
from qcar_twin.parameters import Parameter, ParameterSet

GROUPS, EACH = 12, 40
GROUP = np.repeat(np.arange(GROUPS), EACH)
FREE = ParameterSet([Parameter("slope", 1.0, -50.0, 50.0, "-", "k", std=20.0)])
TRUTH = 1.3


def fitted(random, shared):
  """A line through the origin, y = slope x, with unit noise and a disturbance that each group shares along x."""
  x = random.normal(1.0, 0.3, GROUPS * EACH)
  y = TRUTH * x + random.normal(size=len(x)) + shared * random.normal(size=GROUPS)[GROUP] * x
  return fit(lambda values: values[:, :1] * x - y, FREE, robust=np.inf)


@pytest.mark.parametrize("shared", [0.0, 0.5])
def test_nine_of_ten_intervals_hold_the_truth_whether_samples_share_or_not(shared):
  random = np.random.default_rng(3)
  fits = [fitted(random, shared) for _ in range(600)]
  inside = [abs(f.theta[0] - TRUTH) <= 1.645 * fitted_std(f, GROUP)[0] for f in fits]
  plain = [abs(f.theta[0] - TRUTH) <= 1.645 * f.std[0] for f in fits]
  assert np.mean(inside) > 0.88  # never below the plain deviations: wider where nothing is shared
  assert (np.mean(plain) < 0.6) == (shared > 0.0)


def test_few_groups_widen_an_interval():
  one = fitted(np.random.default_rng(1), 0.5)
  assert fitted_std(one, GROUP % 2)[0] > fitted_std(one, np.arange(len(GROUP)))[0]


def test_an_estimate_at_its_bound_keeps_its_prior():
  tight = ParameterSet([Parameter("slope", 1.0, 0.5, 1.1, "-", "k", std=20.0)])
  x = np.ones(GROUPS * EACH)
  one = fit(lambda values: values[:, :1] * x - 3.0 * x, tight, robust=np.inf)
  assert one.at_bound[0] and fitted_std(one, GROUP)[0] == pytest.approx(20.0)
