"""The baselines do what they are known for, with their known weaknesses."""

import numpy as np
import pytest

from calibration.concealed.campaign.reference_methods import (
  METHODS,
  bic_ranking,
  raw_residual,
  run_baselines,
  unprofiled_ranking,
  white_noise_bic,
)
from calibration.diagnosis.black_box import boosted_residual, rms
from calibration.diagnosis.scan import explained, scan
from calibration.fitting.observations import observe
from tests.calibration.diagnosis import diagnosis_rig as rig


@pytest.fixture(scope="module")
def answers(offset_pool):
  twin = offset_pool.problem.twin
  holdout = rig.measure(twin, rig.drive(4, seed=77, pose=True), {"steering_offset": 0.03}, seed=78)
  return run_baselines(offset_pool, holdout), holdout


def test_all_four_answer(answers):
  assert tuple(answers[0]) == METHODS
  assert all(answers[0][m].method == m for m in METHODS)


def test_recalibration_alone_names_nothing_and_is_the_error_before(offset_pool, answers):
  answer, holdout = answers[0]["recalibration"], answers[1]
  seen = observe(holdout, rig.VEHICLE)
  prediction = offset_pool.problem.twin.rollout(offset_pool.base.theta[None], seen.stretches.segments)
  assert answer.claims == () and answer.ranking == ()
  assert answer.holdout == pytest.approx(rms(seen, seen.predict(prediction)[0] - seen.measured))


def test_unprofiled_ranking_takes_what_the_base_absorbs_for_evidence():
  twin = rig.LinearTwin()
  # the cornering stiffness is wrong by so much that its prior bound, not the data, stops the fit of a poor base
  problem = rig.problem_of(twin, rig.measure(twin, rig.drive(), {"cornering_stiffness_front": 5.0}))
  base = rig.solved(problem)
  poor = rig.solved(problem)
  shifted = base.theta.copy()
  shifted[problem.parameters.index("cornering_stiffness_front")] = 4.0
  poor.residual = problem.residual(shifted[None])[0]
  ranking = dict(unprofiled_ranking(scan(problem, poor, twin.mechanisms)))
  assert max(ranking, key=lambda n: ranking[n]) == "gyro_scale"  # which the profiled scan knows to be the stiffness


def test_unprofiled_ranking_finds_a_plain_effect(answers):
  answer = answers[0]["unprofiled_ranking"]
  assert answer.claims == ("steering_offset",)
  values = [nats for _, nats in answer.ranking]
  assert values == sorted(values, reverse=True) and values[-1] >= 0.0


def test_explained_is_the_best_scaled_drop():
  change, residual = np.array([1.0, 2.0, 0.0]), np.array([-2.0, -4.0, 3.0])
  assert explained(change, residual) == pytest.approx(0.5 * (29.0 - 9.0))
  assert explained(-change, residual) == 0.0  # the wrong direction explains nothing
  assert explained(-change, residual, signed=True) == explained(change, residual)
  assert explained(np.zeros(3), residual) == 0.0


def test_bic_is_schwarz(offset_pool):
  problem, base = offset_pool.problem, offset_pool.base
  raw = raw_residual(problem, base)[: base.n_train]
  channel = problem.observations.channel[: base.n_train]
  expected = len(base.free) * np.log(len(raw))
  for index in np.unique(channel):
    part = raw[channel == index]
    expected += len(part) * np.log(max(np.mean(part**2), 1e-300))
  assert white_noise_bic(problem, base) == pytest.approx(expected)
  order = bic_ranking(offset_pool)
  assert order[0][0] == frozenset(["steering_offset"])
  assert [s for _, s in order] == sorted(s for _, s in order)


def test_bic_predicts_with_its_model(answers):
  before, after = answers[0]["recalibration"].holdout, answers[0]["white_noise_bic"].holdout
  assert answers[0]["white_noise_bic"].claims == ("steering_offset",)
  assert after["yaw_rate"] < before["yaw_rate"] and after["accel_y"] < before["accel_y"]


def test_trees_learn_what_follows_from_the_state_but_name_nothing(answers):
  before, after = answers[0]["recalibration"].holdout, answers[0]["boosted_trees"].holdout
  assert answers[0]["boosted_trees"].claims == ()
  assert after["yaw_rate"] < 0.95 * before["yaw_rate"]
  assert after["motor_speed"] < 1.1 * before["motor_speed"]


def test_trees_leave_a_perfect_twin_nearly_alone(clean_pool):
  problem, base = clean_pool.problem, clean_pool.base
  observations, prediction = problem.observations, problem.predict(base.theta[None])
  raw = raw_residual(problem, base)
  half = np.zeros(len(raw))
  left = boosted_residual(observations, prediction, half, observations, prediction, raw)
  assert np.allclose(left, raw)  # nothing to learn, nothing changed


def test_trees_learn_nothing_where_the_twin_flies_apart(offset_pool):
  """Some values of one channel are no numbers, and all of another: the rest is learnt as ever."""
  problem, base = offset_pool.problem, offset_pool.base
  observations, prediction = problem.observations, problem.predict(base.theta[None])
  raw = raw_residual(problem, base)
  broken, turn, ahead = raw.copy(), observations.select("yaw_rate"), observations.select("accel_x")
  broken[np.flatnonzero(turn)[:5]], broken[ahead] = np.nan, np.inf
  left = boosted_residual(observations, prediction, broken, observations, prediction, raw)
  assert np.isfinite(left).all() and np.array_equal(left[ahead], raw[ahead])
  assert np.sum(left[turn] ** 2) < 0.8 * np.sum(raw[turn] ** 2)


def test_without_holdout_there_are_names_but_no_errors(offset_pool):
  named = run_baselines(offset_pool, [])
  assert named["unprofiled_ranking"].claims and not any(a.holdout for a in named.values())
