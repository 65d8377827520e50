"""The fit: exact on linear problems, honest about what the data don't say."""

import functools

import numpy as np
import pytest

from calibration.fitting import optimiser
from calibration.fitting.optimiser import fit
from calibration.fitting.slopes import broyden, central_differences, finite_differences
from qcar_twin.parameters import Parameter, ParameterSet


def parameters(**changes) -> ParameterSet:
  """Two parameters whose units are ten powers of ten apart."""
  small = dict(nominal=2e-6, lower=0.0, upper=1e-4, std=5e-5) | changes
  return ParameterSet(
    [Parameter("stiffness", 100.0, 0.0, 1e4, "N/rad", std=3e3), Parameter("inertia", unit="kg m^2", **small)]
  )


def linear(matrix, target):
  return lambda theta: theta @ matrix.T - target


@pytest.fixture
def problem():
  rng = np.random.default_rng(3)
  matrix = rng.normal(size=(400, 2)) * [1e-2, 1e6]
  truth = np.array([181.0, 7e-6])
  return matrix, truth, matrix @ truth + rng.normal(size=400)


def test_a_linear_problem_gives_the_closed_form_posterior(problem):
  matrix, _, target = problem
  p = parameters()
  fitted = fit(linear(matrix, target), p, robust=np.inf)
  precision = matrix.T @ matrix + np.diag(1.0 / p.std**2)
  mean = np.linalg.solve(precision, matrix.T @ target + p.nominal / p.std**2)
  np.testing.assert_allclose(fitted.theta, mean, rtol=1e-6)
  np.testing.assert_allclose(fitted.covariance, np.linalg.inv(precision), rtol=1e-5)
  assert fitted.identifiable.all()
  assert not fitted.at_bound.any()


def test_a_linear_problem_takes_one_jacobian(problem):
  """A step that keeps its promise is tried alone; the small one after it, foretold by the same Jacobian, is the end."""
  matrix, _, target = problem
  p = parameters()
  fitted = fit(linear(matrix, target), p, robust=np.inf)
  assert fitted.evaluations == 1 + len(p) + 2


def test_without_a_tolerance_a_fresh_jacobian_that_promises_nothing_is_the_end(problem):
  """From the minimum itself a fit costs a start, and a Jacobian and the step tried with it for each stencil."""
  matrix, _, target = problem
  p = parameters()
  there = fit(linear(matrix, target), p, robust=np.inf).theta
  stencils = (*optimiser.FORWARD, *optimiser.STENCILS)
  fitted = fit(linear(matrix, target), p, there, robust=np.inf, tolerance=0.0, stencils=stencils)
  assert fitted.evaluations == 1 + len(p) + 1 + len(optimiser.STENCILS) * (2 * len(p) + 1)
  np.testing.assert_allclose(fitted.theta, there, rtol=1e-6)


def test_truth_lies_within_three_standard_deviations_in_nearly_all_repeats():
  rng = np.random.default_rng(5)
  matrix, truth = rng.normal(size=(200, 2)) * [1e-2, 1e6], np.array([181.0, 7e-6])
  score = []
  for _ in range(60):
    fitted = fit(linear(matrix, matrix @ truth + rng.normal(size=200)), parameters(), robust=np.inf)
    score.append(np.abs(fitted.theta - truth) / fitted.std)
  assert np.mean(np.array(score) < 1.0) == pytest.approx(0.68, abs=0.12)
  assert np.max(score) < 4.0


def test_a_step_response_gives_its_gain_and_time_constant_back():
  time = np.linspace(0.0, 3.0, 200)
  p = ParameterSet(
    [Parameter("gain", 1.0, 0.0, 50.0, "rad/s/V", std=30.0), Parameter("tau", 0.1, 0.01, 5.0, "s", std=3.0)]
  )
  response = lambda t: t[:, :1] * (1.0 - np.exp(-time / t[:, 1:]))
  target = response(np.array([[12.0, 0.6]]))
  fitted = fit(lambda t: (response(t) - target) / 0.01, p, iterations=30, robust=np.inf, step=1e-4)
  np.testing.assert_allclose(fitted.theta, [12.0, 0.6], rtol=1e-4)
  assert list(fitted.iterations) == sorted(fitted.iterations, reverse=True)


def test_a_parameter_stops_at_its_bound_and_says_so(problem):
  matrix, _, target = problem
  fitted = fit(linear(matrix, target), parameters(upper=4e-6), robust=np.inf)
  assert fitted.theta[1] == pytest.approx(4e-6)
  assert fitted.at_bound.tolist() == [False, True]
  assert not fitted.identifiable[1]


def test_what_the_data_do_not_show_keeps_its_prior(problem):
  matrix, _, target = problem
  blind = matrix * [1.0, 0.0]
  fitted = fit(linear(blind, target), parameters(), robust=np.inf)
  assert fitted.theta[1] == pytest.approx(2e-6)
  assert fitted.std[1] == pytest.approx(5e-5)
  assert fitted.identifiable.tolist() == [True, False]


def test_spikes_do_not_move_a_robust_fit(problem):
  matrix, truth, target = problem
  spiked = target.copy()
  spiked[::40] += 500.0
  plain, robust = (fit(linear(matrix, spiked), parameters(), robust=width) for width in (np.inf, 2.0))
  error = lambda f: np.max(np.abs(f.theta - truth) / truth)
  assert error(robust) < 0.1 * error(plain)


def test_a_start_that_is_not_finite_is_refused():
  with pytest.raises(ValueError, match="not finite; start from nominal"):
    fit(lambda t: np.full((len(t), 5), np.nan), parameters())


def test_differences_are_mirrored_at_a_bound_and_exact_on_a_line(problem):
  matrix, _, target = problem
  p = parameters()
  top = p.upper
  jacobian = finite_differences(linear(matrix, target), p, top, linear(matrix, target)(top[None])[0])
  np.testing.assert_allclose(jacobian, matrix, rtol=1e-6)


def test_broyden_makes_the_jacobian_reproduce_the_step():
  rng = np.random.default_rng(0)
  jacobian, r, outcome = rng.normal(size=(7, 2)), rng.normal(size=7), rng.normal(size=7)
  here, there = np.array([1.0, 2e-6]), np.array([1.5, 3e-6])
  new = broyden(jacobian, r, here, outcome, there, np.array([1.0, 1e-6]))
  np.testing.assert_allclose(new @ (there - here), outcome - r, rtol=1e-12)


def test_a_class_figure_is_weighed_in_factors():
  """One value measured to 100 N of a stiffness known to a factor of 3: the minimum is that of a fine grid."""
  p = ParameterSet([Parameter("stiffness", 500.0, 10.0, 5000.0, "N", factor=3.0)])
  found = fit(lambda theta: (theta - 150.0) / 100.0, p, iterations=30, robust=np.inf, tolerance=0.0)
  grid = np.linspace(50.0, 600.0, 55001)
  cost = 0.5 * ((grid - 150.0) / 100.0) ** 2 + 0.5 * (np.log(grid / 500.0) / np.log(3.0)) ** 2
  assert found.theta[0] == pytest.approx(grid[np.argmin(cost)], abs=0.5)
  assert found.cost == pytest.approx(cost.min(), abs=1e-4)


def test_a_rough_cost_is_followed_to_its_valley_over_wide_stencils():
  """A staircase whose steps are wider than a forward difference: its slope is that over many of them."""
  p = ParameterSet([Parameter(name, 0.0, -20.0, 20.0, "-", std=1.0) for name in "abc"])
  rng = np.random.default_rng(8)
  matrix = rng.normal(size=(60, 3))
  residual = lambda theta: (np.round(theta / 0.05) * 0.05 - 1.0) @ matrix.T * 5.0
  search = functools.partial(fit, residual, p, robust=np.inf, tolerance=0.0, iterations=60)
  ends = lambda *stencils: [search(start, stencils=stencils).theta for start in 4.0 * starts]
  starts = rng.normal(size=(10, 3))
  away = lambda found: np.abs(np.array(found) - 1.0).max(axis=1)
  for wide in (optimiser.STENCILS, (*optimiser.FORWARD, *optimiser.STENCILS)):
    assert (away(ends(*wide)) < 0.15).sum() >= 9
  assert (away(ends(*optimiser.FORWARD)) < 0.15).sum() <= 5


def test_a_damping_that_holds_lets_go_again():
  """Along a bent valley: steps are short where it bends, and may be as long again where it is straight."""
  p = ParameterSet([Parameter(name, 0.0, -50.0, 50.0, "-", typical=1.0) for name in "ab"])
  valley = lambda theta: np.stack([10.0 * (theta[:, 1] - theta[:, 0] ** 2), 3.0 * (theta[:, 0] - 5.0)], axis=1)
  search = functools.partial(fit, valley, p, robust=np.inf, tolerance=0.0, iterations=60, step=1e-4)
  least = search(np.array([5.0, 25.0])).cost
  far = search(np.array([-3.0, 9.0]))
  assert far.iterations[0] > 280.0 and far.cost < least + 1.0
  assert far.evaluations < 200


def test_central_differences_are_exact_on_a_parabola_and_one_sided_at_a_bound():
  p = ParameterSet([Parameter("a", 2.0, 0.0, 3.0, "-", typical=1.0)])
  slope = lambda at: central_differences(lambda theta: theta**2, p, np.array([at]), np.array([0.1]))
  assert slope(2.0) == pytest.approx(np.array([[4.0]])) and slope(3.0) == pytest.approx(np.array([[5.9]]))
  with pytest.raises(ValueError, match="a moves"):
    central_differences(lambda theta: np.full_like(theta, np.nan), p, np.array([2.0]), np.array([0.1]))


def test_a_part_that_jumps_within_a_stencil_has_the_slopes_of_the_other_side():
  p = ParameterSet([Parameter("a", 2.0, 0.0, 3.0, "-", typical=1.0)])
  jump = lambda theta: np.where(theta > 2.01, 50.0, 0.0) * [0.0, 0.0, 1.0, 1.0]
  residual = lambda theta: theta**2 * [1.0, 3.0, 1.0, -2.0] + jump(theta)
  at, half, part = np.array([2.0]), np.array([0.1]), np.array([0, 0, 1, 1])
  bent = central_differences(residual, p, at, half)
  assert bent[:2, 0] == pytest.approx([4.0, 12.0]) and np.all(bent[2:] > 200.0)
  smooth = central_differences(residual, p, at, half, (residual(at[None])[0], part))
  assert smooth[:, 0] == pytest.approx([4.0, 12.0, 3.9, -7.8])
