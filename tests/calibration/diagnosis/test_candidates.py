"""Candidates on a linear car: Gauss-Newton is exact, standard deviations are those of the normal equations."""

import copy

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calibration.diagnosis.candidates import begin, candidate, refine, simulate
from tests.calibration.diagnosis import diagnosis_rig as rig


def normal_equations(problem, free):
  """Closed form of the maximum a posteriori estimate and its covariance."""
  anchor = problem.embed(free.names, free.nominal, problem.parameters.nominal)[0]
  origin = problem.residual(anchor[None])[0][: problem.n_train]
  columns = []
  for name in free.names:
    moved = anchor.copy()
    moved[problem.parameters.index(name)] += 1.0
    columns.append(problem.residual(moved[None])[0][: problem.n_train] - origin)
  jacobian = np.stack(columns, axis=1)
  curvature = jacobian.T @ jacobian + np.diag(1.0 / free.std**2)
  return free.nominal - np.linalg.solve(curvature, jacobian.T @ origin), np.linalg.inv(curvature)


@pytest.mark.parametrize("mechanisms", [(), ("steering_offset",), ("side_force", "steering_offset")])
def test_estimates_are_those_of_the_normal_equations(offset_pool, mechanisms):
  model = rig.solved(offset_pool.problem, mechanisms)
  values, covariance = normal_equations(offset_pool.problem, model.free)
  assert_allclose(model.values, values, rtol=2e-4)
  assert_allclose(model.std, np.sqrt(np.diag(covariance)), rtol=1e-3)
  assert model.estimate(model.free.names[0]) == (model.values[0], model.std[0])


def test_judging_rows_do_not_pull(offset_pool):
  problem = offset_pool.problem
  assert 0 < problem.n_train < len(problem.observations)
  model = rig.solved(problem)
  spoilt = rig.solved(problem)
  spoilt.residual = spoilt.residual.copy()
  spoilt.residual[problem.n_train :] += 100.0
  assert spoilt.cost == model.cost
  assert_allclose(spoilt.gradient, model.gradient)


def test_a_step_that_raises_the_cost_is_not_taken(offset_pool):
  problem = offset_pool.problem
  model = rig.solved(problem)
  before = model.values.copy(), model.cost
  model.jacobian = -model.jacobian  # every step goes the wrong way
  model.settled = False
  refine(problem, [model], 1)
  assert model.cost == before[1]
  assert_allclose(model.values, before[0])


def test_a_child_starts_from_its_parent(offset_pool):
  parent = offset_pool.models[frozenset(["steering_offset"])]
  child = candidate(offset_pool.problem, ("side_force", "steering_offset"), parent, rig.BASE, {"side_force": 0.2})
  assert child.estimate("steering_offset")[0] == parent.estimate("steering_offset")[0]
  assert child.estimate("side_force")[0] == 0.2
  shared = child.free.index("steering_offset")
  assert_allclose(child.jacobian[:, shared], parent.jacobian[:, parent.free.index("steering_offset")])


def test_candidates_side_by_side_equal_candidates_alone(offset_pool):
  problem = offset_pool.problem
  together = [candidate(problem, (name,), offset_pool.base, rig.BASE) for name in ("steering_offset", "side_force")]
  simulate(problem, together)
  refine(problem, together, 2)
  for item in together:
    alone = candidate(problem, item.mechanisms, offset_pool.base, rig.BASE)
    simulate(problem, [alone])
    refine(problem, [alone], 2)
    assert_allclose(alone.values, item.values, rtol=1e-5)  # trial steps may tie to rounding


def test_a_larger_model_fits_no_worse(offset_pool):
  for key, model in offset_pool.models.items():
    if key:
      assert model.cost <= offset_pool.base.cost + 1e-6


def test_what_only_judges_is_predicted_where_a_candidate_ends(offset_pool):
  """Steps leave it alone; what a refined candidate says of it is what a simulation of everything says."""
  problem = offset_pool.problem
  model = candidate(problem, ("steering_offset",), None, rig.BASE)
  simulate(problem, [model])
  started = model.residual.copy()
  refine(problem, [model], 2, full=True)
  assert model.validation_current and np.abs(model.residual[problem.n_train :] - started[problem.n_train :]).max() > 0.1
  assert_allclose(model.residual, problem.residual(model.theta[None])[0], atol=1e-9)


def test_a_model_begun_ends_like_one_that_was_simulated(offset_pool):
  """What only judges is not predicted at the start, and is at the end, even where no step was worth taking."""
  problem = offset_pool.problem
  whole, begun = (candidate(problem, ("steering_offset",), None, rig.BASE) for _ in range(2))
  simulate(problem, [whole])
  begin(problem, [begun])
  assert not begun.validation_current and begun.cost == whole.cost and not begun.residual[problem.n_train :].any()
  for iterations in (0, 2):
    refine(problem, [whole], iterations, full=True)
    refine(problem, [begun], iterations, full=True)
    assert begun.validation_current
    assert_allclose(begun.residual, whole.residual, atol=1e-9)
    assert_allclose(begun.values, whole.values, atol=1e-12)


def test_no_set_fits_worse_than_its_subset(offset_pool):
  """One that does, as a search that went astray leaves it, takes the subset's estimates and its cost."""
  pool = offset_pool
  for key, model in ((key, model) for key, model in pool.models.items() if key):
    parent = pool.best_subset(key)
    astray = copy.copy(model)
    astray.residual = 10.0 * parent.residual
    taken = pool.not_worse(astray, parent)
    assert model.cost <= parent.cost * (1.0 + 1e-6) and taken.cost <= parent.cost * (1.0 + 1e-6) < astray.cost
