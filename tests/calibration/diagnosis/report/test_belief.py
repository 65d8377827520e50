"""What a diagnosis believes: models by probability, parameters by their covariance."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.report import belief as written
from calibration.diagnosis.report.belief import belief
from calibration.diagnosis.score import clustered_std, scatter
from tests.calibration.diagnosis.diagnosis_results import diagnosis_of
from tests.calibration.diagnosis.diagnosis_rig import session, solved


@pytest.fixture(scope="module")
def pool():
  made = session({"steering_offset": 0.03, "side_force": 0.5})
  both = solved(made.problem, ("side_force", "steering_offset"))
  made.models[frozenset(both.mechanisms)] = both
  return made


def claiming(pool, *claims, monkeypatch):
  """A diagnosis with claims of (name, probability, shared, indistinguishable)."""
  found = diagnosis_of(pool, tuple(name for name, *_ in claims))
  made = [
    dataclasses.replace(claim, probability=p, shared=shared, indistinguishable_from=alike)
    for claim, (_, p, shared, alike) in zip(found.decision.claims, claims, strict=True)
  ]
  monkeypatch.setattr(written, "objections", lambda diagnosis: ())
  return dataclasses.replace(found, decision=dataclasses.replace(found.decision, claims=tuple(made)))


def weights(posterior):
  return {tuple(sorted(m.mechanisms)): m.probability for m in posterior.models}


def test_claims_are_independent_and_nothing_has_the_rest(pool, monkeypatch):
  sure, likely = ("steering_offset", 0.9, 0.9, ()), ("side_force", 0.7, 0.7, ())
  found = weights(belief(claiming(pool, sure, likely, monkeypatch=monkeypatch)))
  expected = {
    ("side_force", "steering_offset"): 0.63, ("steering_offset",): 0.27, ("side_force",): 0.07, (): 0.03,
  }  # fmt: skip
  assert found == pytest.approx(expected)


def test_names_that_fit_as_well_share_what_the_claim_leaves(pool, monkeypatch):
  shared = ("steering_offset", 0.6, 0.9, ("side_force",))
  found = weights(belief(claiming(pool, shared, monkeypatch=monkeypatch)))
  assert found == pytest.approx({("steering_offset",): 0.6, ("side_force",): 0.3, (): 0.1})
  unfitted = ("steering_offset", 0.6, 0.9, ("steering_lag",))
  found = weights(belief(claiming(pool, unfitted, monkeypatch=monkeypatch)))
  assert found == pytest.approx({("steering_offset",): 0.6 / 0.7, (): 0.1 / 0.7})


def test_where_the_repair_is_not_written_the_recalibrated_twin_is_all(pool, monkeypatch):
  found = claiming(pool, ("steering_offset", 0.9, 0.9, ()), monkeypatch=monkeypatch)
  monkeypatch.setattr(written, "objections", lambda diagnosis: ("it errs more",))
  assert weights(belief(found)) == {(): 1.0}
  monkeypatch.setattr(written, "objections", lambda diagnosis: ())
  assert weights(belief(diagnosis_of(pool, verdict="no_mismatch"))) == {(): 1.0}


def test_parameters_have_the_deviations_that_are_reported(pool, monkeypatch):
  model = pool.models[frozenset(["steering_offset"])]
  observations = pool.problem.observations
  covariance = scatter(model, observations).covariance()
  np.testing.assert_allclose(np.sqrt(np.diag(covariance)), clustered_std(model, observations), rtol=1e-9)
  assert np.linalg.eigvalsh(covariance / np.outer(model.free.scale, model.free.scale)).min() > -1e-12
  found = claiming(pool, ("steering_offset", 1.0, 1.0, ()), monkeypatch=monkeypatch)
  (only,) = belief(found).models
  assert only.names == tuple(model.free.names)
  np.testing.assert_array_equal(only.values, model.values)
