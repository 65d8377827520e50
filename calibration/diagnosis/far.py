"""Effects so large that recalibration bends out of shape around them.

A delay of 0.2 s is no small change of a twin whose tyres went soft to imitate it: seen from there, its signature is
another one. So delays and lags are also tried on the parameters as they were before any recalibration, at sizes up to
several times the typical one, and where that explains much, the whole model is fitted from there.
"""

from collections.abc import Sequence

import numpy as np

from calibration.diagnosis.candidates import Candidate, candidate, half_square, refine, simulate
from calibration.diagnosis.problem import Problem
from qcar_twin.parameters import ParameterSet

FAR = ("steering_delay", "steering_lag", "drive_delay", "drive_lag", "imu_latency", "pose_latency")
_SIZES = (1.0, 2.5, 5.0)  # of the typical one
_WORTH = 30.0  # nats a trial must bring to the twin before recalibration to be fitted
_RIVALS = 1.5  # and how far above the recalibrated twin's cost it may lie
_MOST = 2  # mechanisms that are fitted
_STEPS = 5


def far_models(problem: Problem, base: Candidate, priors: ParameterSet, considered: Sequence[str]) -> list[Candidate]:
  """Models with one large delay or lag each, fitted from the parameters before recalibration; often none.

  Args:
    problem: residuals.
    base: the recalibrated twin.
    priors: declarations of the base parameters; their nominal values are where it starts.
    considered: ids that may be used.
  """
  begin = problem.embed(priors.names, priors.nominal, problem.parameters.nominal)[0]
  trials = [(name, size) for name in FAR if name in considered for size in _SIZES]
  if not trials:
    return []
  thetas = np.stack([begin, *(_with(problem, begin, name, size) for name, size in trials)])
  first, *costs = (half_square(r[: problem.fitted]) for r in problem.residual(thetas))
  best: dict[str, tuple[float, float]] = {}
  for (name, size), cost in zip(trials, costs, strict=True):
    best[name] = min(best.get(name, (np.inf, 0.0)), (cost, size))
  limit = min(first - _WORTH, _RIVALS * base.cost)
  chosen = sorted((cost, name, size) for name, (cost, size) in best.items() if cost < limit)[:_MOST]
  made = [
    candidate(problem, (name,), None, priors, {_amplitude(problem, name): _value(problem, name, size)})
    for _, name, size in chosen
  ]
  simulate(problem, made)
  refine(problem, made, _STEPS, full=True)
  return made


def _amplitude(problem: Problem, name: str) -> str:
  return problem.mechanism(name).parameters[0].name


def _value(problem: Problem, name: str, size: float) -> float:
  p = problem.mechanism(name).parameters[0]
  return float(np.clip((p.null or 0.0) + size * (p.typical or p.scale), p.lower, p.upper))


def _with(problem: Problem, theta: np.ndarray, name: str, size: float) -> np.ndarray:
  out = theta.copy()
  out[problem.parameters.index(_amplitude(problem, name))] = _value(problem, name, size)
  return out
