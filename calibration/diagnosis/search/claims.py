"""A claim: a mechanism that is held responsible, with its evidence, its alternatives and its estimates."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, clustered_std, compare, evidence
from calibration.diagnosis.search.weighing import Levels, Weighed, matters, shown_size, stretched, weighed
from calibration.fitting.optimiser import bounded_solve
from calibration.fitting.tolerances import sensor_error_mechanisms
from qcar_twin.parameters import ParameterSet

# radius, in the usual deviations, of a disc that biases half as large on average leave as seldom as the square about it
_ROUND = 1.1


@dataclasses.dataclass(frozen=True)
class Claim:
  """One mechanism that is held responsible.

  Attributes:
    mechanism: id.
    probability: that the name is right, 0 to 1.
    shared: that it or one of `indistinguishable_from` is.
    evidence_nats: log profile likelihood ratio over the model without it.
    held_out: the same comparison on recordings left out.
    parameters: value, std and unit of each of its parameters.
    alternatives: what fitted in its place, with its nats, best first.
    indistinguishable_from: alternatives that fit as well.
    certain: False if what is left over throws doubt on the name.
  """

  mechanism: str
  probability: float
  shared: float
  evidence_nats: float
  held_out: Comparison
  parameters: dict[str, dict[str, float | str]]
  alternatives: tuple[tuple[str, float], ...]
  indistinguishable_from: tuple[str, ...]
  certain: bool


def claim(pool: Pool, best: Candidate, name: str, levels: Levels) -> Claim:
  """One mechanism of a model, weighed against the model without it and against what fits in its place.

  Names that can't be told apart have one probability together, as if the others were not there, since that several fit
  does not make it less likely that something is; of it each has at most its part by its own odds. A name that was
  stretched as far as it may, or that makes no difference, is none.

  Args:
    pool: all fitted models, the one without `name` among them.
    best: the model behind the claims.
    name: id of one of its mechanisms.
    levels: what decides.
  """
  found, without = weighed(pool, best, name), pool.models[frozenset(best.mechanisms) - {name}]
  equivalent = tuple(rival for rival, _ in found.alternatives if _alike(pool, best, name, rival, levels))
  shared = _probability(found, levels, equivalent) * (not stretched(pool, best, name))
  shared *= matters(pool, best, without, levels)
  odds = [_odds(pool, _replaced(pool, best, name, n), n, levels) for n in (name, *equivalent)]
  return Claim(
    mechanism=name,
    probability=min(_probability(found, levels), odds[0] / sum(odds) * shared),
    shared=shared,
    evidence_nats=evidence(best, without, pool.problem.observations),
    held_out=found.held_out,
    parameters=_estimates(pool, name, best, levels),
    alternatives=found.alternatives[:5],
    indistinguishable_from=equivalent,
    certain=True,
  )


def _alike(pool: Pool, best: Candidate, name: str, rival: str, levels: Levels) -> bool:
  """Whether neither driving left out nor what was measured of the car tells a rival in a name's place from it."""
  model = _replaced(pool, best, name, rival)
  gap = compare(best, model, pool.problem.observations)
  return gap.t < levels.equivalent and gap.priors < levels.near and not stretched(pool, model, rival)


def _replaced(pool: Pool, model: Candidate, name: str, other: str) -> Candidate:
  """A model with another name in one's place."""
  return pool.models[frozenset(model.mechanisms) - {name} | {other}]


def _odds(pool: Pool, model: Candidate, name: str, levels: Levels) -> float:
  probability = _probability(weighed(pool, model, name), levels)
  return probability / (1.0 - probability)


def _probability(found: Weighed, levels: Levels, leaving_out: tuple[str, ...] = ()) -> float:
  return levels.probability(found.t, found.size, found.margin(leaving_out))


def _estimates(pool: Pool, name: str, model: Candidate, levels: Levels) -> dict[str, dict[str, float | str]]:
  """Value, standard deviation and unit of a mechanism's parameters; the deviation holds the formula's own error."""
  values = model.free.named(model.values)
  scatter = model.free.named(clustered_std(model, pool.problem.observations))
  found = [p for p in pool.problem.mechanism(name).parameters if p.name in model.free]
  form = {p.name: 0.0 if p.null is None else levels.form * abs(values[p.name] - p.null) for p in found}
  return {
    p.name: {"value": values[p.name], "std": float(np.hypot(scatter[p.name], form[p.name])), "unit": p.unit}
    for p in found
  }


def bias_claims(pool: Pool, best: Candidate, levels: Levels) -> list[Claim]:
  """IMU biases far beyond what every IMU has; they are part of every model, so leaving them out is the test."""
  claims = []
  for mechanism in sorted(sensor_error_mechanisms(pool.problem.twin.mechanisms), key=lambda m: m.name):
    name, names = mechanism.name, [p.name for p in mechanism.parameters if p.name in best.free]
    usual = {n: e.std for n, e in mechanism.sensor_errors.items()}
    size = shown_size(pool, best, name)
    if not names or size < levels.bias or not _beyond_usual(best, names, usual):
      continue
    without = _at_null(best, names)
    test = compare(best, without, pool.problem.observations)
    probability = levels.probability(test.t_with_priors, size, without.cost - best.cost)
    if probability >= levels.claim and matters(pool, best, without, levels):
      gain = evidence(best, without, pool.problem.observations)
      estimates = _estimates(pool, name, best, levels)
      claims.append(Claim(name, probability, probability, gain, test, estimates, (), (), True))
  return claims


def _beyond_usual(model: Candidate, names: list[str], declared: Mapping[str, float]) -> bool:
  """Whether the biases together exceed the standard deviation that every such sensor is believed to have.

  Not that of its prior: where the gyro was read at rest, this says how well its bias is known and not how usual it is.
  Together, since a bias of 0.2 m/s^2 halfway between two axes is no smaller than one along either.
  """
  usual = {n: declared.get(n, model.free[n].std) for n in names}
  sizes = [(model.estimate(n)[0] - (model.free[n].null or 0.0)) / s for n, s in usual.items() if s is not None]
  return not sizes or float(np.linalg.norm(sizes)) > (1.0 if len(sizes) == 1 else _ROUND)


def _at_null(model: Candidate, names: list[str]) -> Candidate:
  """A model with some parameters held at zero and the rest refitted within their bounds, to first order."""
  held = [model.free.index(n) for n in names]
  rest = [i for i in range(len(model.free)) if i not in held]
  move = np.zeros(len(model.free))
  move[held] = -model.values[held]
  pull = model.gradient + model.curvature @ move
  free = ParameterSet(model.free[model.free.names[i]] for i in rest)
  values = bounded_solve(model.curvature[np.ix_(rest, rest)], pull[rest], model.values[rest], free)
  move[rest] = values - model.values[rest]
  return dataclasses.replace(
    model,
    free=free,
    values=values,
    residual=model.residual + model.jacobian @ move,
    jacobian=model.jacobian[:, rest],
  )
