"""How large a mechanism of a fitted model is, and whether it went as far as it may."""

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool


def shown_size(pool: Pool, model: Candidate, name: str) -> float:
  """Largest amplitude of a mechanism over its typical size, as far as the driving shows it."""
  mechanism = pool.problem.mechanism(name)
  shown = mechanism.observable_share(model.free.named(model.values), pool.problem.driving)
  return shown * max(
    (
      abs(model.values[model.free.index(p.name)] - p.null) / (p.typical or p.scale)
      for p in mechanism.parameters
      if p.null is not None and p.name in model.free
    ),
    default=0.0,
  )


def stretched(pool: Pool, model: Candidate, name: str) -> bool:
  """Whether an amplitude went as far as it may, to a standard deviation.

  What it then makes up for is more often something else. A bound where the physics ends is one of its values.
  """
  mechanism = pool.problem.mechanism(name)
  for p in mechanism.parameters:
    if p.null is None or p.name not in model.free:
      continue
    value, std = model.estimate(p.name)
    bounds = {p.lower, *(() if p.name in mechanism.whole else (p.upper,))} - {p.null}
    if any(abs(value - bound) < max(std, 1e-6 * p.scale) for bound in bounds):
      return True
  return False
