"""What an answer is measured against must not be seen by the methods it is compared with."""

import dataclasses
from types import SimpleNamespace

import pytest

from calibration.concealed.campaign.reference import baselines, oracle
from calibration.fitting.windows import DEFAULT_CUT
from tests.calibration.diagnosis import diagnosis_rig as rig


@pytest.fixture(scope="module")
def missed(offset_pool):
  """A diagnosis that never nominated the effect that is there, and recordings kept aside."""
  nominated = {key: model for key, model in offset_pool.models.items() if "steering_offset" not in key}
  pool = dataclasses.replace(offset_pool, models=nominated)
  twin = pool.problem.twin
  holdout = rig.measure(twin, rig.drive(4, seed=77, pose=True), {"steering_offset": 0.03}, seed=78)
  return SimpleNamespace(diagnosis=SimpleNamespace(pool=pool), twin=twin, cut=DEFAULT_CUT), holdout


def test_the_right_model_does_not_join_the_pool(missed):
  outcome, holdout = missed
  before, before_answers = dict(outcome.diagnosis.pool.models), baselines(outcome, holdout)
  assert oracle(outcome, ["steering_offset"], holdout)["nats"] > 100.0
  assert outcome.diagnosis.pool.models == before
  assert baselines(outcome, holdout) == before_answers


def test_bic_chooses_among_what_was_nominated(missed):
  outcome, holdout = missed
  oracle(outcome, ["steering_offset"], holdout)
  assert "steering_offset" not in baselines(outcome, holdout)["white_noise_bic"]["claims"]
