"""Models that were searched for on a stand-in end where the car that counts has its minimum, with its residual."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.candidates import candidate, refine, simulate
from calibration.diagnosis.confirm import confirm, confirm_best, correct
from calibration.diagnosis.search.gather import gather
from calibration.fitting.likelihood import Problem
from qcar_twin.plant import Prediction
from tests.calibration.diagnosis import diagnosis_rig as rig

STIFFER = 1.25  # slopes of the stand-in over those of the car


class StandIn(rig.LinearTwin):
  """The linear car's answer at an anchor, with slopes that are too steep beyond it."""

  def __init__(self, anchor):
    super().__init__()
    self.anchor = anchor

  def rollout(self, theta, segments):
    there = super().rollout(self.anchor[None], segments).signals
    change = super().rollout(np.atleast_2d(theta) - self.anchor, segments).signals
    if segments.pose is not None:
      change[..., :3] = 0.0
    return Prediction(there + STIFFER * change, segments.period)


class StoodIn(Problem):
  """A problem on the stand-in, as the surrogate's is one on the reduced car."""

  def at(self, theta):
    return StoodIn(StandIn(np.array(theta)), self.observations, self.weighting, self.n_train, self.base)

  @property
  def exact(self):
    return Problem(rig.LinearTwin(), self.observations, self.weighting, self.n_train, self.base)


@pytest.fixture
def pool(offset_pool):
  """The session of a car with an offset of the steering, with models fitted on the stand-in alone."""
  old = offset_pool.problem
  problem = StoodIn(StandIn(offset_pool.base.theta), old.observations, old.weighting, old.n_train, old.base)
  models = {}
  for key in ((), ("steering_offset",), ("side_force",), ("side_force", "steering_offset")):
    made = candidate(problem, key, offset_pool.base, offset_pool.priors)
    simulate(problem, [made])
    refine(problem, [made], 4, full=True)
    models[frozenset(key)] = made
  return dataclasses.replace(offset_pool, problem=problem, models=models)


def truly(pool, model):
  return pool.problem.exact.residual(model.theta[None])[0]


def test_a_model_is_fitted_on_to_the_minimum_of_the_car_that_counts(pool, offset_pool):
  model = pool.models[frozenset(["steering_offset"])]
  exact = offset_pool.models[frozenset(["steering_offset"])]
  simulate(pool.problem.exact, [begun := dataclasses.replace(model)])
  assert begun.cost > exact.cost + 1.0
  correct(pool.problem, model)
  assert model.cost < exact.cost + 1.0 and model.corrected
  np.testing.assert_allclose(model.residual, truly(pool, model), atol=1e-9)


def test_what_was_not_asked_for_closely_keeps_its_estimates(pool):
  model = pool.models[frozenset(["side_force"])]
  before = model.theta.copy()
  confirm(pool, [model])
  np.testing.assert_array_equal(model.theta, before)
  np.testing.assert_allclose(model.residual, truly(pool, model), atol=1e-9)
  assert model.confirmed and not model.corrected
  assert not pool.models[frozenset(["side_force", "steering_offset"])].confirmed


def test_a_decision_rests_on_confirmed_models_that_are_nested(pool):
  confirm_best(pool)
  best = pool.best(list(pool.models.values()))
  assert best.mechanisms and best.corrected and pool.base.corrected
  for key, model in pool.models.items():
    if key <= frozenset(best.mechanisms):
      assert model.confirmed
      np.testing.assert_allclose(model.residual, truly(pool, model), atol=1e-9)
    for other, smaller in pool.models.items():
      if other < key and model.confirmed and smaller.confirmed:
        assert model.cost <= smaller.cost + 1e-9
  np.testing.assert_array_equal(pool.problem.twin.anchor, best.theta)


def test_a_step_takes_the_word_back(pool):
  model = pool.models[frozenset(["side_force"])]
  confirm(pool, [model])
  model.values = model.values * 1.05
  model.theta = pool.problem.embed(model.free.names, model.values, model.theta)[0]
  simulate(pool.problem, [model])
  model.settled = False
  refine(pool.problem, [model], 1, full=True)
  assert not model.confirmed


def test_where_mujoco_searched_there_is_nothing_to_confirm(offset_pool):
  before = {key: m.residual.copy() for key, m in offset_pool.models.items()}
  confirm_best(offset_pool)
  confirm(offset_pool, list(offset_pool.models.values()))
  assert all(np.array_equal(m.residual, before[key]) for key, m in offset_pool.models.items())


def test_what_was_not_confirmed_is_no_worse_than_what_it_holds(pool):
  """A recalibrated twin that was fitted on leaves behind whatever had begun at it."""
  base, single = pool.base, frozenset(["side_force"])
  pool.models[single] = dataclasses.replace(pool.models[single], residual=1.01 * base.residual, confirmed=False)
  assert pool.models[single].cost > base.cost
  confirm(pool, closely=[base])
  assert pool.models[single].cost == pytest.approx(base.cost, rel=1e-9)


def test_evidence_is_of_models_that_the_car_that_counts_has_driven(pool):
  """Nats of a stand-in less nats of the car are no evidence, however far behind the best a set is."""
  confirm_best(pool)
  for model in pool.of_size(1):  # as if they were too far behind to be confirmed with the best
    model.confirmed = False
    model.residual = model.residual * 1.001
  found = {m.mechanisms: m.drop for m in gather(pool).models}
  for key in (("side_force",), ("steering_offset",)):
    model = pool.models[frozenset(key)]
    np.testing.assert_allclose(model.residual, truly(pool, model), atol=1e-9)
    assert found[key] == pytest.approx(pool.base.cost - model.cost, rel=1e-5)
