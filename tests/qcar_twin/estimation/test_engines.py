"""The engine filterpy for one car: the same estimates as the batched algebra, and errors where it cannot be."""

import copy
import dataclasses

import numpy as np
import pytest

from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.settings import PRIORS, FilterSettings
from qcar_twin.extras import MissingExtra
from tests.qcar_twin.estimation.estimation_rig import CAR, journey, run
from tests.qcar_twin.estimation.test_kalman_exact import HARD, troubled

CENTRAL = FilterSettings(central=True, imu_y=0.02)
UNKNOWN = dataclasses.replace(HARD, steering_delay=0.02).estimating(*PRIORS)


@pytest.mark.parametrize("watched", [True, False])
@pytest.mark.parametrize(
  "chosen", [FilterSettings(), HARD, CENTRAL, UNKNOWN], ids=["plain", "hard", "central", "unknown"]
)
def test_filterpy_filters_a_drive_as_the_batched_algebra_does(chosen, watched):
  """Late fixes, spikes, gates, lost and partial fixes: states, covariances, evidence and refusals, to 1e-9."""
  trip = troubled(10.0, seed=8)
  filters = [FederatedFilter(CAR, chosen, watched, engine) for engine in ("batched", "filterpy")]
  mine, theirs = (run(trip, federated=one, latency=5)[0] for one in filters)
  for a, b in zip(mine, theirs, strict=True):
    assert (a.valid, a.reasons, a.warnings) == (b.valid, b.reasons, b.warnings)
    if a.bicycle is None:
      continue
    for own, other in zip(a.bicycle, b.bicycle, strict=True):
      np.testing.assert_allclose(own, other, rtol=0, atol=1e-9)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=0, atol=1e-9)
    assert (a.pose_x, a.pose_y) == pytest.approx((b.pose_x, b.pose_y), abs=1e-9)
  assert filters[0].refused == filters[1].refused
  np.testing.assert_allclose(filters[0].evidence, filters[1].evidence, rtol=1e-9)


def test_a_copy_goes_on_with_its_engine():
  trip = journey(4.0)
  one = FederatedFilter(CAR, engine="filterpy")
  first, _ = run(trip, federated=one)
  again = copy.deepcopy(one)
  assert again.estimate(4.5).pose_x == pytest.approx(one.estimate(4.5).pose_x, abs=1e-12)
  assert first[-1].valid


def test_what_an_engine_cannot_do_is_said(monkeypatch):
  with pytest.raises(ValueError, match="for one car, not for 3"):
    FederatedBatch(CAR, FilterSettings(), 3, engine="filterpy")
  with pytest.raises(ValueError, match="valid are: batched, filterpy"):
    FederatedFilter(CAR, engine="numpy")
  monkeypatch.setitem(__import__("sys").modules, "filterpy.kalman", None)
  with pytest.raises(MissingExtra, match=r"qcar-twin\[filterpy\]"):
    FederatedFilter(CAR, engine="filterpy")
