"""What makes a simpler twin do, and what is fitted before two are compared."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.curves.naming import refits
from calibration.diagnosis.curves.naming.forms import LEVEL
from calibration.diagnosis.curves.naming.refits import MATERIAL, fit_together
from qcar_twin.parameters import Parameter, ParameterSet


def test_a_difference_that_is_sure_but_does_not_matter_refuses_nothing():
  assert refits.Test(t=30.0, nats=500.0, worse=1.0 + 0.9 * MATERIAL).p_value == 1.0
  assert refits.Test(t=30.0, nats=500.0, worse=1.0 + 1.1 * MATERIAL).p_value < 1e-9


def test_a_difference_that_chance_makes_refuses_nothing_however_large():
  assert refits.Test(t=1.0, nats=500.0, worse=2.0).p_value > LEVEL
  assert refits.Test(t=-3.0, nats=-50.0, worse=2.0).p_value > 0.99


@dataclasses.dataclass
class Model:
  """Costs the square of the distance of its parameters from (1, 2), plus one where it lacks the second."""

  free: ParameterSet
  values: np.ndarray
  theta: np.ndarray
  residual: np.ndarray
  settled: bool = False
  mechanisms: tuple[str, ...] = ()

  @property
  def cost(self):
    return float(self.residual @ self.residual)


A, B = (Parameter(name, 0.0, -9.0, 9.0, "-", std=1.0, null=0.0) for name in "ab")


def embedded(names, values, around):
  return np.array([np.concatenate([values, [0.0] * (2 - len(values))])])


PROBLEM = SimpleNamespace(embed=embedded)


def made(parameters, *values):
  at = np.array(values, float)
  return Model(ParameterSet(parameters), at, PROBLEM.embed((), at, None)[0], np.zeros(2))


@pytest.fixture
def fitting(monkeypatch):
  """Stands in for the simulation: residuals follow from the parameters, and `full` tells who was fitted to the end."""
  full = []

  def simulate(problem, models):
    for item in models:
      item.residual = item.theta - np.array([1.0, 2.0])

  def refine(problem, models, iterations, full_slopes=False, **given):
    if given.get("full"):
      full.extend(models)

  monkeypatch.setattr(refits, "simulate", simulate)
  monkeypatch.setattr(refits, "refine", refine)
  return full


def test_the_plainest_is_fitted_to_the_end_from_the_best_place(fitting):
  plainest, near, far = made([A], -5.0), made([A, B], 1.0, 1.5), made([A, B], 4.0, 4.0)
  order = fit_together(PROBLEM, [plainest, near, far], plainest)
  assert order == [near, plainest, far]
  assert plainest.values.tolist() == [1.0] and plainest.theta.tolist() == [1.0, 0.0]  # where `near` had it
  assert any(item is plainest for item in fitting) and not plainest.settled


def test_the_plainest_stays_within_what_was_measured_of_it(fitting):
  """Another model may have freed what the plainest knows closely."""
  measured = Parameter("a", 0.0, -0.1, 0.1, "-", null=0.0)
  plainest, near = made([measured], -0.1), made([A, B], 1.0, 2.0)
  fit_together(PROBLEM, [plainest, near], plainest)
  assert plainest.values.tolist() == [0.1] and plainest.theta.tolist() == [0.1, 0.0]


def test_without_a_plainest_the_best_are_fitted_to_the_end(fitting):
  models = [made([A, B], float(k), 2.0) for k in range(6)]
  order = fit_together(PROBLEM, models)
  assert [m.cost for m in order] == sorted(m.cost for m in models)
  assert sorted(m.cost for m in fitting) == [0.0, 1.0, 1.0]


@pytest.mark.parametrize("times", [1.5, 30.0, 1e5])
def test_a_model_that_is_far_worse_is_told_so_however_far(times):
  rng = np.random.default_rng(0)
  count, blocks = 2000, 40
  observations = SimpleNamespace(
    names=tuple("abcdefgh"),
    recording=np.repeat(np.arange(8), count // 8),
    block=np.repeat(np.arange(blocks), count // blocks),
  )
  good, wrong = rng.normal(size=(2, count))
  model = lambda residual: SimpleNamespace(
    residual=residual, n_train=count, free=ParameterSet([A]), values=np.zeros(1), cost=0.0
  )
  test = refits.tested(model(good + times * wrong), model(good), SimpleNamespace(observations=observations))
  assert test.worse == pytest.approx(np.hypot(1.0, times), rel=0.05) and test.p_value < 1e-6


def test_a_chain_of_names_is_held_against_the_twin_it_began_with():
  """One step makes the errors larger by what nobody misses; two of them by more."""
  count, blocks = 8000, 80
  observations = SimpleNamespace(
    names=tuple("abcdefgh"),
    recording=np.repeat(np.arange(8), count // 8),
    block=np.repeat(np.arange(blocks), count // blocks),
  )
  good, first, second = np.random.default_rng(1).normal(size=(3, count))
  model = lambda residual: SimpleNamespace(
    residual=residual, n_train=count, free=ParameterSet([A]), values=np.zeros(1), cost=0.0
  )
  free, one = model(good), model(good + 0.12 * first)
  both = model(good + 0.12 * first + 0.12 * second)
  trials = SimpleNamespace(base=one, freest=one, problem=SimpleNamespace(observations=observations))
  assert refits.borne(one, trials) == refits.borne(both, trials) == 1.0
  trials.freest = free
  assert refits.borne(one, trials) == 1.0 and refits.borne(both, trials) < 1e-3
