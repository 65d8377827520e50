"""Bounds of forms that follow from the nominal car's size, and go further where another car asks for it.

A dead zone of at most 3 V, a drag of at most 2 kg/m or half of the angle lost at lock are generous for a QCar; other
cars have more of them. Nothing and the whole are bounds by law: no motor lets go by more than the whole. So a form's
size that ends at another bound is fitted again with a bound twice as far, once; what ends there again is at a bound,
and says so.
"""

import dataclasses
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.fitting.likelihood import Problem
from calibration.fitting.recalibration import RecalibratedTwin, settled
from qcar_twin.parameters import Parameter, ParameterSet

Array = NDArray[np.float64]

_FURTHER = 2.0
_AT = 1e-6  # of the range: nearer than that is at the bound


def further(problem: Problem, forms: Collection[str], free: ParameterSet, values: Array) -> ParameterSet:
  """The same parameters with those bounds twice as far at which forms ended, values (p,); itself where none did."""
  made = [_moved(problem.parameters[p.name], p, float(v)) if _sized(problem, forms, p) else p
          for p, v in zip(free, values, strict=True)]  # fmt: skip
  return ParameterSet(made) if any(new is not old for new, old in zip(made, free, strict=True)) else free


def with_room(found: RecalibratedTwin, forms: Collection[str]) -> RecalibratedTwin:
  """A fitted twin, fitted on with more room where forms in it ended at their bounds; itself where none did."""
  free = found.fit.parameters
  wide = further(found.problem, forms, free, found.fit.theta)
  if wide is free:
    return found
  return settled(found.problem, found.noise_models, wide, found.fit.theta, found.command_shift)


def widened(problem: Problem, model: Candidate) -> bool:
  """Move the bounds at which a model's forms ended; whether any was."""
  before, model.free = model.free, further(problem, model.mechanisms, model.free, model.values)
  return model.free is not before


def as_wide(made: Candidate, base: Candidate, problem: Problem) -> None:
  """Give the forms of a model made from another the bounds that were widened there, and the values those left room for.

  What every car has to within a tolerance, and a form frees, goes back to the tolerance where the form is left out.
  """
  forms = [p for p in made.free if p.name in base.free and _sized(problem, made.mechanisms, p)]
  names = [p.name for p in forms if _wider(base.free[p.name], p)]
  made.free = made.free.replace(
    **{n: dataclasses.replace(made.free[n], lower=base.free[n].lower, upper=base.free[n].upper) for n in names}
  )
  for name in names:
    value = base.values[base.free.index(name)]
    made.values[made.free.index(name)] = made.theta[problem.parameters.index(name)] = value


def said(problem: Problem, forms: Collection[str], fitted: ParameterSet) -> tuple[str, ...]:
  """A sentence for every bound of a form that was widened."""
  declared = [p for name in forms for p in problem.mechanism(name).parameters if p.name in fitted]
  return tuple(
    f"{p.name} ended at a bound of its range, {p.lower:g} to {p.upper:g} {p.unit}, which is made for the nominal car;"
    f" it was fitted again between {fitted[p.name].lower:g} and {fitted[p.name].upper:g}"
    for p in declared
    if _wider(fitted[p.name], p)
  )


def _sized(problem: Problem, forms: Collection[str], parameter: Parameter) -> bool:
  """Whether a parameter is a form's size."""
  outlined = (m for m in [problem.mechanism(name) for name in forms] if m.outlined_by)
  own = {p.name for mechanism in outlined for p in mechanism.parameters}
  return parameter.name in own and (parameter.unit != "-" or parameter.null is not None)


def _moved(declared: Parameter, parameter: Parameter, value: float) -> Parameter:
  near = _AT * (parameter.upper - parameter.lower)
  whole = declared.unit == "-" and declared.upper == 1.0
  if value >= parameter.upper - near and parameter.upper == declared.upper and not whole:
    return dataclasses.replace(parameter, upper=_FURTHER * declared.upper)
  # there is nothing less than none
  if value <= parameter.lower + near and parameter.lower == declared.lower != 0.0:
    return dataclasses.replace(parameter, lower=min(_FURTHER * declared.lower, declared.lower / _FURTHER))
  return parameter


def _wider(one: Parameter, other: Parameter) -> bool:
  return one.upper > other.upper or one.lower < other.lower
