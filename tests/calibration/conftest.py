"""Sessions of the linear car that several tests look at; nothing here is changed by a test."""

import pytest

from tests.calibration.diagnosis import diagnosis_rig as rig


@pytest.fixture(scope="session")
def offset_pool():
  """A car whose wheels point 0.03 rad to the left, with a pose."""
  return rig.session({"steering_offset": 0.03}, seed=3, pose=True)


@pytest.fixture(scope="session")
def clean_pool():
  """A car without any hidden effect."""
  return rig.session({}, seed=5)


@pytest.fixture(scope="session")
def pair_pool():
  """A car with two effects and the models of both, one and none."""
  pool = rig.session({"steering_offset": 0.03, "side_force": 0.5}, seed=3, pose=True)
  both = frozenset(["side_force", "steering_offset"])
  pool.models[both] = rig.solved(pool.problem, tuple(sorted(both)))
  return pool
