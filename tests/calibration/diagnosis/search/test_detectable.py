"""Predicted sizes are those from which on the decision claims; what is absorbed has none."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.decision.claims import claim
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.decision.weighing import probability
from calibration.diagnosis.score import compare, from_blocks
from calibration.diagnosis.search.detectable import Prediction, detectable
from calibration.diagnosis.search.gather import gather
from tests.calibration.diagnosis import diagnosis_rig as rig
from tests.calibration.diagnosis.diagnosis_results import EASY
from tests.calibration.diagnosis.search.detectable_rates import rates


@pytest.fixture(scope="module")
def smallest(clean_pool):
  return detectable(clean_pool, gather(clean_pool))


def test_what_recalibration_absorbs_has_no_size(smallest):
  absorbed = smallest["gyro_scale"]  # on this car it is the cornering stiffness by another name
  assert absorbed.size is None and absorbed.share is None and absorbed.nats is None
  shown = smallest["quadratic_drag"]
  assert 0.0 < shown.size < 4.0 and shown.unit == "kg/m" and shown.share == pytest.approx(shown.size / 0.4)
  assert shown.named >= shown.size


def test_the_size_is_the_least_that_is_claimed(clean_pool, smallest):
  evidence, levels = gather(clean_pool), usual_levels()
  prediction, signature = Prediction(clean_pool, evidence), clean_pool.signatures["quadratic_drag"]
  own = prediction.sums(signature.direction.astype(np.float64))
  rivals = prediction.rivals(signature, clean_pool.signatures)
  told = lambda k: claim(prediction.named(signature, own, rivals, k), evidence.base, evidence, levels).shared
  least = smallest["quadratic_drag"].size / signature.tried["quadratic_drag"]
  assert told(least) >= levels.claim > told(least * 2 ** (-1 / 12))


def test_an_effect_of_twice_the_size_shows_four_times_the_nats(clean_pool, smallest):
  signature, evidence = clean_pool.signatures["quadratic_drag"], gather(clean_pool)
  scanned = signature.tried["quadratic_drag"]
  nats = 0.5 * float(np.sum(signature.direction**2)) * (smallest["quadratic_drag"].size / scanned) ** 2
  assert smallest["quadratic_drag"].nats == pytest.approx(nats)
  strict = dataclasses.replace(usual_levels(), claim=0.8)
  assert detectable(clean_pool, evidence, strict)["quadratic_drag"].size > smallest["quadratic_drag"].size


def test_what_is_weighed_is_what_a_fit_of_that_car_gives(clean_pool):
  """The same car with the effect, and the same noise: evidence of its fit against the prediction without it."""
  prediction = Prediction(clean_pool, gather(clean_pool))
  signature, scanned = clean_pool.signatures["quadratic_drag"], clean_pool.signatures["quadratic_drag"].tried
  own = prediction.sums(signature.direction.astype(np.float64))
  told = prediction.named(signature, own, prediction.rivals(signature, clean_pool.signatures), 1.0)
  pool = rig.session(dict(scanned), seed=5)  # the noise of `clean_pool`
  base, model = pool.base, pool.models[frozenset(["quadratic_drag"])]
  assert told.held_out.drop == pytest.approx(base.cost - model.cost, rel=0.05)
  assert told.t == pytest.approx(compare(model, base, pool.problem.observations).t_with_priors, rel=0.25)
  other = pool.models[frozenset(["steering_offset"])]
  nats = {a.name: a.nats for a in told.alternatives}
  assert nats["steering_offset"] == pytest.approx(base.cost - other.cost, abs=0.05 * told.held_out.drop)
  assert probability(told, EASY) > 0.5


def test_blocks_compare_as_residuals_do():
  found = from_blocks(np.array([1.0, -0.01, 2.0, 3.0]), 50.0)
  assert found.gain == pytest.approx(5.99) and found.share_positive == 1.0 and found.before == 50.0
  assert found.t == pytest.approx(5.99 / found.standard_error)


@pytest.mark.slow
def test_predicted_sizes_part_what_is_claimed_from_what_is_not():
  found = list(rates(2, (0.5, 0.71, 1.41, 2.0)))
  small = [hit for _, multiple, hit in found if multiple < 1.0]
  large = [hit for _, multiple, hit in found if multiple > 1.0]
  assert sum(small) <= 1 and sum(large) >= len(large) - 1
