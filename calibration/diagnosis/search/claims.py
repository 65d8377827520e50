"""A claim: a mechanism that is held responsible, with its evidence, its rivals and its estimates."""

import dataclasses
import math
from collections.abc import Collection, Mapping

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, clustered_std, compare, evidence
from calibration.diagnosis.search.thresholds import Thresholds, material, significant, stretched
from calibration.fitting.tolerances import sensor_error_mechanisms
from qcar_twin.parameters import ParameterSet

# standard deviation, as a share of the size, by which a formula right in kind but not in every detail misses; set by
# hand from the errors of right names on concealed cases
_FORM = 0.19
# radius, in the usual deviations, of a disc that biases half as large on average leave as seldom as the square about it
_ROUND = 1.1
_AT_BOUND = 0.4  # what is left of a probability whose mechanism was stretched as far as it may: too little for a claim


@dataclasses.dataclass(frozen=True)
class Claim:
  """One mechanism that is held responsible.

  Attributes:
    mechanism: id.
    probability: that the name is right, 0 to 1.
    evidence_nats: log profile likelihood ratio over the model without it.
    held_out: the same comparison on recordings left out.
    parameters: value, std and unit of each of its parameters.
    rivals: what fitted in its place, with its nats, best first.
    equivalent_to: rivals that fit as well.
    certain: False if what is left over throws doubt on the name.
  """

  mechanism: str
  probability: float
  evidence_nats: float
  held_out: Comparison
  parameters: dict[str, dict[str, float | str]]
  rivals: tuple[tuple[str, float], ...]
  equivalent_to: tuple[str, ...]
  certain: bool


def claim(pool: Pool, best: Candidate, name: str, thresholds: Thresholds) -> Claim:
  """One mechanism of the best model, weighed against the model without it and against what fits in its place.

  Args:
    pool: all fitted models, the one without `name` among them.
    best: the model behind the claims.
    name: id of one of its mechanisms.
    thresholds: what a serious rival needs, and how close an equivalent one comes.
  """
  without = pool.models[frozenset(best.mechanisms) - {name}]
  held_out = compare(best, without, pool.problem.observations)
  rivals, serious, equivalent = [], {}, []
  for key, model in pool.models.items():
    other = key - set(without.mechanisms)
    if len(key) == len(best.mechanisms) and set(without.mechanisms) < key and len(other) == 1 and name not in other:
      (rival,) = other
      rivals.append((rival, without.cost - model.cost))
      # one that would not be claimed itself (it frees priors and predicts worse) is no rival
      stands = significant(compare(model, without, pool.problem.observations), thresholds)
      if stands and not _needed_beside(pool, model, name, thresholds):
        serious[rival] = without.cost - model.cost
      gap = compare(best, model, pool.problem.observations)
      # one that leaves what was measured as bent as it was is another matter, however alike they predict
      alike = gap.t < thresholds.equivalent or gap.gain < 0.03 * held_out.gain
      if alike and gap.priors < thresholds.priors:
        equivalent.append(rival)
  rivals.sort(key=lambda r: -r[1])
  probability = _against_rivals(held_out, without.cost - best.cost, serious, equivalent)
  return Claim(
    mechanism=name,
    probability=probability * (_AT_BOUND if stretched(pool, best, name) else 1.0),
    evidence_nats=evidence(best, without, pool.problem.observations),
    held_out=held_out,
    parameters=_estimates(pool, name, best),
    rivals=tuple(rivals[:5]),
    equivalent_to=tuple(equivalent),
    certain=True,
  )


def _needed_beside(pool: Pool, rival: Candidate, name: str, thresholds: Thresholds) -> bool:
  """Whether a name is still needed where a rival is in its place: both act, and neither speaks against the other."""
  both = pool.models.get(frozenset([*rival.mechanisms, name]))
  return both is not None and significant(compare(both, rival, pool.problem.observations), thresholds.beside_others())


def _against_rivals(
  held_out: Comparison, gain: float, serious: Mapping[str, float], equivalent: Collection[str]
) -> float:
  """Probability of a name by its margin over the next serious rival, in nats; or its share where several tie.

  That several names fit does not make it less likely that something is there: each has its part of what all have.
  """
  others = [nats for name, nats in serious.items() if name not in equivalent]
  equals = 1 + sum(name in equivalent for name in serious)
  alone = _probability(held_out, gain - max(serious.values(), default=0.0))
  return max(alone, _probability(held_out, gain - max(others, default=0.0)) / equals)


def _probability(held_out: Comparison, margin: float) -> float:
  """Probability that the name is right, from the margin over the next rival and the held-out t.

  A logistic in log margin and t; its numbers are set by hand, not fitted.
  """
  score = -1.2 + 0.75 * math.log1p(max(margin, 0.0) / 3.0) + 0.25 * (min(held_out.t, 8.0) - 3.0)
  return float(np.clip(1.0 / (1.0 + math.exp(-score)), 0.02, 0.99))


def _estimates(pool: Pool, name: str, model: Candidate) -> dict[str, dict[str, float | str]]:
  """Value, standard deviation and unit of a mechanism's parameters; the deviation holds the formula's own error."""
  values = model.free.named(model.values)
  scatter = model.free.named(clustered_std(model, pool.problem.observations))
  found = [p for p in pool.problem.mechanism(name).parameters if p.name in model.free]
  form = {p.name: 0.0 if p.null is None else _FORM * abs(values[p.name] - p.null) for p in found}
  return {
    p.name: {"value": values[p.name], "std": float(np.hypot(scatter[p.name], form[p.name])), "unit": p.unit}
    for p in found
  }


def bias_claims(pool: Pool, best: Candidate, thresholds: Thresholds) -> list[Claim]:
  """IMU biases far beyond what every IMU has; they are part of every model, so leaving them out is the test."""
  claims = []
  for mechanism in sorted(sensor_error_mechanisms(pool.problem.twin.mechanisms), key=lambda m: m.name):
    name, names = mechanism.name, [p.name for p in mechanism.parameters if p.name in best.free]
    usual = {n: e.std for n, e in mechanism.sensor_errors.items()}
    if not names or not material(pool, best, name, thresholds.bias) or not _beyond_usual(best, names, usual):
      continue
    without = _at_null(best, names)
    test = compare(best, without, pool.problem.observations)
    if significant(test, thresholds):
      gain = evidence(best, without, pool.problem.observations)
      estimates = _estimates(pool, name, best)
      claims.append(Claim(name, _probability(test, gain), gain, test, estimates, (), (), True))
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
  """A model with some parameters held at zero and the rest refitted, to first order."""
  held = [model.free.index(n) for n in names]
  rest = [i for i in range(len(model.free)) if i not in held]
  move = np.zeros(len(model.free))
  move[held] = -model.values[held]
  pull = model.gradient + model.curvature @ move
  scale = model.free.scale[rest]
  inner = model.curvature[np.ix_(rest, rest)] * np.outer(scale, scale)
  move[rest] = -np.linalg.lstsq(inner, pull[rest] * scale, rcond=None)[0] * scale
  return dataclasses.replace(
    model,
    free=ParameterSet(model.free[model.free.names[i]] for i in rest),
    values=(model.values + move)[rest],
    residual=model.residual + model.jacobian @ move,
    jacobian=model.jacobian[:, rest],
  )
