"""What recalibration made of measured parameters, set against how far a true value would be moved."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.report.grounds import prior_shifts
from tests.calibration.diagnosis import diagnosis_rig as rig


def test_a_measured_parameter_that_moved_stands_out():
  recordings = rig.measure(rig.LinearTwin(), rig.drive(), {"mass": 3.8}, noise=0.2)
  shifts = prior_shifts(rig.solved(rig.problem_of(rig.LinearTwin(), recordings)))
  assert max(shifts, key=lambda n: abs(shifts[n])) == "mass" and shifts["mass"] > 9.0


@pytest.mark.parametrize(
  ("informed", "expected"), [(0.99, 6.0 / 0.99**0.5), (0.6, 6.0 / 0.6**0.5), (0.1, 6.0 / 0.5**0.5)]
)
def test_a_shift_of_what_the_data_hardly_inform_is_not_blown_up(clean_pool, informed, expected):
  """Share of the mass's prior variance that the data take away; with less than a twentieth it is not asked."""
  base = rig.solved(clean_pool.problem)
  i, std = base.free.index("mass"), base.free["mass"].std
  values, stds = base.values.copy(), base.std.copy()
  values[i], stds[i] = base.free["mass"].nominal + 6.0 * std, std * np.sqrt(1.0 - informed)
  shifted = SimpleNamespace(free=base.free, values=values, std=stds)
  assert prior_shifts(shifted)["mass"] == pytest.approx(expected)
  stds[i] = std * np.sqrt(0.96)
  assert "mass" not in prior_shifts(shifted)


def test_no_measured_parameter_no_conflict(clean_pool):
  base = rig.solved(clean_pool.problem)
  index = [i for i, p in enumerate(base.free) if p.std is None]
  free = type(base.free)(p for p in base.free if p.std is None)
  bare = SimpleNamespace(free=free, values=base.values[index], std=base.std[index])
  assert prior_shifts(bare) == {}
