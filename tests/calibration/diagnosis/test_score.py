"""Leave-one-out by linear algebra is the refit without that group; gains and shares add up."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.score import (
  CAP,
  clustered_std,
  compare,
  compared,
  errors_taken_off,
  held_out,
  prior_part,
)
from calibration.fitting.optimiser import prior_gradient
from calibration.intervals.clusters import groups_of
from qcar_twin.parameters import Parameter, ParameterSet
from tests.calibration.diagnosis import diagnosis_rig as rig


@pytest.mark.parametrize("mechanisms", [(), ("steering_offset",), ("side_force", "steering_offset")])
def test_leaving_a_group_out_equals_refitting_without_it(offset_pool, mechanisms):
  model = rig.solved(offset_pool.problem, mechanisms)
  group = groups_of(offset_pool.problem.observations)
  quick = held_out(model, group)
  for kind in np.unique(group):
    kept = (group != kind) & (np.arange(len(group)) < model.n_train)
    part, prior = model.jacobian[kept], np.diag(model.free.deviation_slopes(model.values) ** 2)
    slope = part.T @ model.residual[kept] + prior_gradient(model.values, model.free)
    move = -np.linalg.solve(part.T @ part + prior, slope)
    if np.any(np.abs(move) > 3.0 * model.std):
      continue  # such a step is not believed, by rule
    own = group == kind
    assert_allclose(quick[own], model.residual[own] + model.jacobian[own] @ move, atol=1e-9)


def test_judging_groups_are_left_as_they_are(offset_pool):
  model = offset_pool.models[frozenset(["steering_offset"])]
  group = groups_of(offset_pool.problem.observations)
  judged = np.arange(len(group)) >= model.n_train
  moved = held_out(model, group)[judged] - model.residual[judged]
  # nothing is taken out for them; what moves is what the last fit left over
  assert np.abs(moved).max() < 1e-3


def test_the_truth_wins_and_a_bystander_does_not(offset_pool):
  observations = offset_pool.problem.observations
  truth = compare(offset_pool.models[frozenset(["steering_offset"])], offset_pool.base, observations)
  bystander = compare(offset_pool.models[frozenset(["quadratic_drag"])], offset_pool.base, observations)
  assert truth.gain > 50 and truth.t > 4 and truth.share_positive > 0.9
  assert bystander.gain < 5 and bystander.t < 2.6


def test_a_right_name_takes_its_part_off_the_channels_it_acts_on(offset_pool):
  """Against the residuals themselves: all groups are alike, so that each goes as far as the whole fit."""
  observations, base = offset_pool.problem.observations, offset_pool.base
  model = offset_pool.models[frozenset(["steering_offset"])]
  found = errors_taken_off(model, base, observations)
  assert set(found) == set(observations.present)
  rows = observations.select("yaw_rate")
  share = 1.0 - np.linalg.norm(model.residual[rows]) / np.linalg.norm(base.residual[rows])
  assert found["yaw_rate"][0] == pytest.approx(share, abs=0.02) and share > 0.05 and found["yaw_rate"][1] > 3.0
  assert abs(found["motor_speed"][0]) < 0.01
  assert all(abs(size) < 1e-12 for size, _ in errors_taken_off(base, base, observations).values())


def test_comparison_with_itself_is_nothing(offset_pool):
  same = compare(offset_pool.base, offset_pool.base, offset_pool.problem.observations)
  assert same.gain == 0 and same.t == 0 and same.share_positive == 0


def test_groups_are_recordings_or_stretches_where_those_are_few():
  twin = rig.LinearTwin(("steering_offset",))
  many = rig.problem_of(twin, rig.measure(twin, rig.drive(10), {})).observations
  assert_allclose(groups_of(many), many.recording)
  few = rig.problem_of(twin, rig.measure(twin, rig.drive(5), {})).observations
  group = groups_of(few, length=3.0)
  assert len(np.unique(group)) > len(np.unique(few.recording))
  for kind in np.unique(group):
    assert len(np.unique(few.recording[group == kind])) == 1


def test_prior_part_counts_standard_deviations(offset_pool):
  model = rig.solved(offset_pool.problem)
  model.values = model.free.nominal + model.free.std * 2.0
  assert prior_part(model) == pytest.approx(0.5 * 4.0 * len(model.free))


def test_the_pool_prefers_what_holds_on_data_left_out(offset_pool):
  assert offset_pool.best(list(offset_pool.models.values())).mechanisms == ("steering_offset",)


def test_no_block_brings_more_than_the_cap(offset_pool):
  model, base = offset_pool.models[frozenset(["steering_offset"])], offset_pool.base
  test = compare(model, base, offset_pool.problem.observations)
  assert test.gain <= CAP * len(test.blocks)
  assert test.total == pytest.approx(sum(test.blocks))  # none of them is a hundred times the cap


def test_deviations_hold_where_a_group_shares_its_disturbance():
  """The spread of an estimate over many data sets, with a disturbance per group, is what clustered_std says of one."""
  random, groups, each = np.random.default_rng(0), 24, 50
  observations = SimpleNamespace(names=tuple("abcdefghijkl" * 2), recording=np.repeat(np.arange(groups), each))
  free = ParameterSet([Parameter("level", 0.0, -10.0, 10.0, "-", typical=1.0)])
  jacobian = np.ones((groups * each, 1))

  def estimated(shared):
    noise = random.standard_normal(groups * each) + shared * np.repeat(random.standard_normal(groups), each)
    value = -float(noise.mean())
    return Candidate((), free, np.array([value]), noise + value, jacobian, np.array([value]), groups * each)

  for shared in (0.0, 1.0):
    models = [estimated(shared) for _ in range(300)]
    spread = np.std([m.values[0] for m in models])
    said = np.median([clustered_std(m, observations)[0] for m in models])
    assert_allclose(said, spread, rtol=0.25)
  assert models[0].std[0] < 0.25 * spread  # taken as independent witnesses, the samples promise far too much


def test_deviations_of_sums_hold_where_the_numbers_stand_in_for_each_other():
  """Only the sum of two numbers shows: known well, though neither of them is."""
  random, count = np.random.default_rng(1), 24 * 50
  observations = SimpleNamespace(names=tuple("abcdefghijkl" * 2), recording=np.repeat(np.arange(24), 50))
  free = ParameterSet([Parameter(name, 0.0, -10.0, 10.0, "-", std=1.0) for name in "ab"])
  noise = random.standard_normal(count)
  model = Candidate((), free, np.zeros(2), noise - noise.mean(), np.ones((count, 2)), np.zeros(2), count)
  plain = clustered_std(model, observations)
  total, difference = clustered_std(model, observations, np.array([[1.0, 1.0], [1.0, -1.0]]))
  assert plain[0] == pytest.approx(np.sqrt(0.5), rel=0.01) and difference == pytest.approx(np.sqrt(2.0), rel=0.01)
  assert total == pytest.approx(1.0 / np.sqrt(count), rel=0.3)


def test_where_every_block_brings_all_it_may_t_stays_a_number_to_read():
  block = np.repeat(np.arange(25), 4)
  found = compared(np.zeros(100), np.full(100, 10.0), block)
  assert found.gain == 25 * CAP and 10.0 < found.t <= 100.0 * np.sqrt(25)
