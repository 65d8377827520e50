"""All models a search has tried, by the set of mechanisms in them."""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from calibration.diagnosis.candidates import Candidate, candidate, simulate
from calibration.diagnosis.scan import Signature
from calibration.diagnosis.score import compare
from calibration.fitting.likelihood import Problem
from calibration.fitting.recalibration import RecalibratedTwin
from qcar_twin.parameters import ParameterSet


@dataclasses.dataclass
class Pool:
  """All models tried, with what is needed to try more.

  Attributes:
    problem: residuals, with the present weights.
    priors: declarations of the base parameters.
    models: by set of mechanism ids; frozenset() is the recalibrated twin.
    signatures: of the scan.
    floor: smallest standard deviation of each residual channel: the sensors' own noise.
    kept: part of what the scan promised that a mechanism's refit kept, asked when all had the same weights and minimum.
    base_not_converged: whether recalibration had ended so far above its minimum that the search has to begin
      anew from the lower one.
  """

  problem: Problem
  priors: ParameterSet
  models: dict[frozenset[str], Candidate]
  signatures: dict[str, Signature]
  floor: dict[str, float]
  base_not_converged: bool = False
  kept: dict[str, float] = dataclasses.field(default_factory=dict)

  @property
  def base(self) -> Candidate:
    return self.models[frozenset()]

  def model(self, mechanisms: Iterable[str]) -> Candidate:
    """The model of a set of mechanisms."""
    return self.models[frozenset(mechanisms)]

  def of_size(self, size: int) -> list[Candidate]:
    return [m for key, m in self.models.items() if len(key) == size]

  def foremost(self, size: int, count: int | None = None) -> list[Candidate]:
    """The models with so many mechanisms that fit best, best first; all by default."""
    return sorted(self.of_size(size), key=lambda m: m.cost)[:count]

  def best(self, models: Sequence[Candidate]) -> Candidate:
    """The model with the largest gain, held out and in the priors; a mechanism more must bring 2 nats more."""
    return max([self.base, *(m for m in models if m is not self.base)], key=self._worth)

  def _worth(self, model: Candidate) -> float:
    found = compare(model, self.base, self.problem.observations)
    return found.total + found.priors - 2.0 * len(model.mechanisms)

  def best_subset(self, key: frozenset[str]) -> Candidate:
    """The best model with fewer mechanisms of a set."""
    return min((m for k, m in self.models.items() if k < key), key=lambda m: m.cost)

  def offer(self, model: Candidate) -> None:
    """Keep a model where it fits better than what the pool has of its set."""
    key = frozenset(model.mechanisms)
    if key not in self.models or model.cost < self.models[key].cost:
      self.models[key] = self.not_worse(model, self.best_subset(key)) if key else model

  def nest(self) -> None:
    """No set fits worse than its subsets: where one does, since those came down, it takes their estimates over."""
    for key in sorted(filter(None, self.models), key=len):
      self.models[key] = self.not_worse(self.models[key], self.best_subset(key))

  def not_worse(self, item: Candidate, parent: Candidate) -> Candidate:
    """A set that fits worse than its subset takes the subset's estimates, with what was added at its null."""
    if item.cost <= parent.cost:
      return item
    same = candidate(self.problem, item.mechanisms, parent, self.priors)
    same.residual, same.jacobian = parent.residual.copy(), np.where(same.jacobian == 0.0, item.jacobian, same.jacobian)
    return same


def base_candidate(baseline: RecalibratedTwin) -> Candidate:
  """The recalibrated twin as a model of the pool."""
  made = candidate(baseline.problem, (), None, baseline.fit.parameters)
  made.theta, made.values = baseline.theta.copy(), baseline.fit.theta.copy()
  made.jacobian = baseline.jacobian.copy(order="K")
  simulate(baseline.problem, [made])
  made.settled = True
  return made
