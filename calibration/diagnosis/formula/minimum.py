"""A model at the minimum of its cost: what a formula is sought in, and what a formula is fitted into."""

import dataclasses

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.fitting.likelihood import Problem
from calibration.fitting.recalibration import NOTICED, descended


def at_minimum(problem: Problem, model: Candidate) -> tuple[Problem, Candidate]:
  """A model where its cost is lowest, by the recalibration's descent, and the problem put right there.

  Wheels that slip make the cost rough, so a few Gauss-Newton steps end far from its minimum. All free parameters move,
  the base's and the formula's alike. MuJoCo's corrections end where they promise less than a decision would notice.

  Args:
    problem: with the model's mechanisms.
    model: what is free, and where it begins.

  Raises:
    NotFinite: a simulation on the way.
  """
  theta = problem.embed(model.free.names, model.values, problem.parameters.nominal)[0]
  problem, minimum = descended(problem.at(theta), model.free, model.values, NOTICED)
  theta = problem.embed(model.free.names, minimum.theta, problem.parameters.nominal)[0]
  problem = problem.at(theta)
  jacobian = np.zeros((len(problem.observations), len(model.free)))
  jacobian[: model.n_train] = minimum.jacobian
  found = dataclasses.replace(
    model, theta=theta, values=minimum.theta.copy(), residual=problem.residual(theta[None])[0], jacobian=jacobian,
    settled=True, validation_current=True, confirmed=True, corrected=True,
  )  # fmt: skip
  return problem, found
