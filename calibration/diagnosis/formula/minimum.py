"""A model at the minimum of its cost: what a formula is sought in, and what a formula is fitted into."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.fitting.likelihood import Problem
from calibration.fitting.optimiser import NARROWEST, STENCILS, Fit, central_differences, fit
from calibration.fitting.recalibration import NOTICED, descended

Array = NDArray[np.float64]

_ROUGH, _STEPS = 3e-4, 8  # of the cost that an iteration of a rough fit must bring; and so many at most


def at_minimum(problem: Problem, model: Candidate, stencils: Sequence[float] = STENCILS) -> tuple[Problem, Candidate]:
  """A model where its cost is lowest, by the recalibration's descent, and the problem put right there.

  Wheels that slip make the cost rough, so a few Gauss-Newton steps end far from its minimum. All free parameters move,
  the base's and the formula's alike. MuJoCo's corrections end where they promise less than a decision would notice.

  Args:
    problem: with the model's mechanisms.
    model: what is free, and where it begins.
    stencils: that the descent ends with.

  Raises:
    NotFinite: a simulation on the way.
  """
  problem = problem.at(_full(problem, model, model.values))
  problem, minimum = descended(problem, model.free, model.values, NOTICED, True, stencils)
  return _standing(problem, model, minimum.theta, minimum.jacobian)


def near_minimum(problem: Problem, model: Candidate) -> tuple[Problem, Candidate]:
  """The same roughly: good enough to tell how far the residuals scatter that a model leaves."""
  found = rough_fit(problem, model)
  return _standing(problem, model, found.theta, found.jacobian)


def rough_fit(problem: Problem, model: Candidate) -> Fit:
  """Towards a minimum to a few parts in ten thousand of its cost, with slopes that the model came with and few others.

  MuJoCo's corrections are those that the problem came with.
  """
  return fit(
    lambda v: problem.fitted_residual(problem.embed(model.free.names, v, problem.parameters.nominal)),
    model.free, model.values, iterations=_STEPS, tolerance=_ROUGH, robust=np.inf,
    slopes=model.jacobian[: model.n_train],
  )  # fmt: skip


def with_slopes(problem: Problem, model: Candidate) -> Candidate:
  """A model where it stands, with residual and slopes of what is fitted by this problem's weights and corrections."""
  fitted = lambda v: problem.fitted_residual(problem.embed(model.free.names, v, problem.parameters.nominal))
  slopes = np.zeros((len(problem.observations), len(model.free)))
  slopes[: model.n_train] = central_differences(fitted, model.free, model.values, NARROWEST)
  return dataclasses.replace(model, residual=problem.residual(model.theta[None])[0], jacobian=slopes)


def _full(problem: Problem, model: Candidate, values: Array) -> Array:
  return problem.embed(model.free.names, values, problem.parameters.nominal)[0]


def _standing(problem: Problem, model: Candidate, values: Array, slopes: Array) -> tuple[Problem, Candidate]:
  """A model at these values of what is free, and the problem put right there; `slopes` are of what is fitted.

  A stretch that a descent left to MuJoCo takes as long as all others together; the next descent begins without, and
  leaves to it what misleads there.
  """
  theta = _full(problem, model, values)
  problem = problem.at(theta).unguarded()
  jacobian = np.zeros((len(problem.observations), len(model.free)))
  jacobian[: model.n_train] = slopes
  found = dataclasses.replace(
    model, theta=theta, values=values.copy(), residual=problem.residual(theta[None])[0], jacobian=jacobian,
    settled=True, validation_current=True, confirmed=True, corrected=True,
  )  # fmt: skip
  return problem, found
