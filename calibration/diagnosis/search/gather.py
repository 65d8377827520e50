"""From fitted models to evidence: everything that a decision reads, weighed once."""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.confirm import confirm
from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.evidence import (
  Against,
  Alternative,
  Estimate,
  Evidence,
  Measured,
  Model,
  Named,
  Scanned,
  Taken,
  rounded,
)
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.decision.structure import Leftover
from calibration.diagnosis.holdout_errors import ChannelFit, held_out_error
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.scan import Projector
from calibration.diagnosis.score import clustered_std, compare, errors_taken_off
from calibration.diagnosis.search.structure import ensure
from calibration.diagnosis.search.weighing import stretched
from calibration.diagnosis.unexplained.leftover import leftovers
from calibration.fitting.observations import Observations
from calibration.fitting.optimiser import bounded_solve
from calibration.fitting.residual_channels import RESIDUALS
from calibration.fitting.tolerances import sensor_error_mechanisms, usual_errors
from calibration.intervals.clusters import groups_of
from calibration.intervals.forms import size_of
from qcar_twin.parameters import ParameterSet
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

LARGEST = 3  # names in a set
_INDEPENDENT = 1.0  # s between independent residuals: ten times that within which neighbours count as one
CONSIDERED = 4  # sets of each size, those that fit best


def gather(pool: Pool, dataset: str = "") -> Evidence:
  """Evidence of a pool's sets that fit best, up to three names each; fits what those are weighed against."""
  _complete(pool)
  return rounded(Weighing(pool).evidence(dataset))


def _complete(pool: Pool) -> None:
  """Fit what the foremost sets are without each of their names; largest first, since those may join the smaller.

  All of them get MuJoCo's residuals, by which others may come to the fore.
  """
  while True:
    before = set(_considered(pool))
    for size in range(LARGEST, 0, -1):
      ensure(pool, [frozenset(m.mechanisms) - {n} for m in pool.foremost(size, CONSIDERED) for n in m.mechanisms])
    confirm(pool, [pool.models[key] for key in _considered(pool)])
    if set(_considered(pool)) == before:
      return


def _considered(pool: Pool) -> list[frozenset[str]]:
  """The foremost sets of each size."""
  return [frozenset(m.mechanisms) for size in range(1, LARGEST + 1) for m in pool.foremost(size, CONSIDERED)]


def seconds_of(observations: Observations) -> NDArray[np.int64]:
  """Number of the second that each value falls into, (M,)."""
  return groups_of(observations, least=len(observations.names) + 1, length=_INDEPENDENT)


class Weighing:
  """The models of a pool weighed; what is asked of a model several times is computed once."""

  def __init__(self, pool: Pool):
    self.pool, self.observations = pool, pool.problem.observations
    self.compare = functools.cache(lambda larger, smaller: self._test(pool.models[larger], pool.models[smaller]))
    self.second = seconds_of(self.observations)
    self.stretched = functools.cache(lambda key, name: stretched(pool, pool.models[key], name))

  def evidence(self, dataset: str) -> Evidence:
    sets = [[self.pool.base], *(self.pool.foremost(size, CONSIDERED) for size in range(1, LARGEST + 1))]
    models = []
    for size, rows in enumerate(sets):
      smaller = [m for row in sets[:size] for m in row]
      models += [self.model(m, smaller) for m in rows]
    return Evidence(dataset, tuple(models), self.scanned())

  def model(self, model: Candidate, smaller: Sequence[Candidate]) -> Model:
    """A model with its names; smaller: those that it may have to be likely against."""
    base, others = self.pool.base, [m for m in smaller if not set(m.mechanisms) < set(model.mechanisms)]
    against = []
    for other in others:
      gain = self.compare(_key(model), _key(other))
      against.append(Against(_names(other), gain.t_with_priors, other.cost - model.cost))
    return Model(
      mechanisms=_names(model),
      drop=base.cost - model.cost,
      names=tuple(self.named(model, name) for name in _names(model)),
      sensors=tuple(self.sensors(model)),
      against=tuple(against),
      measured=measured_figures(model, self.pool.problem.twin, self.observations),
    )

  def named(self, model: Candidate, name: str) -> Named:
    """A mechanism of a model against the model without it."""
    rest = _key(model) - {name}
    without = self.pool.models[rest]
    fitted = [key for key in self.pool.models if len(key) == len(rest) + 1 and rest < key and name not in key]
    alternatives = [self.alternative(model, key, next(iter(key - rest))) for key in fitted]
    test, at_bound = self.compare(_key(model), rest), self.stretched(_key(model), name)
    row = self._weighed(model, without, name, test, at_bound)
    figures = measured_figures(without, self.pool.problem.twin, self.observations)
    return dataclasses.replace(row, alternatives=tuple(alternatives), without=figures)

  def alternative(self, model: Candidate, key: frozenset[str], name: str) -> Alternative:
    """What stands in a name's place in another model."""
    other, rest = self.pool.models[key], self.pool.models[key - {name}]
    both = self.pool.models.get(key | _key(model))
    gap = self.compare(_key(model), key)
    return Alternative(
      name=name,
      nats=rest.cost - other.cost,
      t=self.compare(key, key - {name}).t_with_priors,
      at_bound=self.stretched(key, name),
      behind_t=gap.t,
      behind_priors=gap.priors,
      beside=max(other.cost - both.cost, 0.0) if both is not None else 0.0,
    )

  def sensors(self, model: Candidate) -> list[Named]:
    """Sensors' own errors of a model, each against the nearest model with one that is usual, or with none if it is.

    Every sensor has some: what says that one errs by more than usual is what the more explains. Several sensors that
    speak late and commands that act early fit alike, and then a usual age fits as well as one beyond it.
    """
    rows, levels = [], usual_levels()
    for mechanism in sorted(sensor_error_mechanisms(self.pool.problem.twin.mechanisms), key=lambda m: m.name):
      names = [p.name for p in mechanism.parameters if p.name in model.free]
      if not names:
        continue
      declared = usual_errors([mechanism], self.observations)
      usual = {n: declared.get(n, model.free[n].std) for n in names}
      away = [(model.value(n) - (model.free[n].null or 0.0)) / s for n, s in usual.items() if s is not None]
      share = levels.usual_reach(len(away)) / max(math.hypot(*away), 1e-12)
      kept = share if share < 1.0 else 0.0
      held = {n: (1.0 - kept) * (model.free[n].null or 0.0) + kept * model.value(n) for n in names}
      without = _held(model, held)
      row = self._weighed(model, without, mechanism.name, self._test(model, without), at_bound=False)
      rows.append(dataclasses.replace(row, deviations=tuple(map(float, away))))
    return rows

  def scanned(self) -> tuple[Scanned, ...]:
    """Every mechanism as the scan saw it, and the slope of its signature by blocks."""
    base, signatures = self.pool.base, self.pool.signatures
    refitted = {m.mechanisms[0]: base.cost - m.cost for m in self.pool.of_size(1)}
    residual, project = base.residual[: base.n_train], Projector(base)
    rows = []
    for name in sorted({*signatures, *refitted}):
      scores: tuple[float, ...] = ()
      if name in signatures:
        direction = project(signatures[name].direction[None].astype(np.float64))[0]
        scores = self._scores(residual, direction)
      gain = signatures[name].gain if name in signatures else None
      rows.append(Scanned(name, gain, refitted.get(name), scores))
    return tuple(rows)

  def _weighed(self, model: Candidate, without: Candidate, name: str, test: Comparison, at_bound: bool) -> Named:
    taken = errors_taken_off(model, without, self.observations)
    return Named(
      name=name,
      held_out=test,
      at_bound=at_bound,
      errors=tuple(Taken(channel, share, t) for channel, (share, t) in taken.items()),
      estimates=self._estimates(model, name),
      scores=self._scores(without.residual[: model.n_train], (model.residual - without.residual)[: model.n_train]),
    )

  def _scores(self, residual: Array, change: Array) -> tuple[float, ...]:
    """Slope of the fit along a change of the fitted residuals, in each second, over the change's norm."""
    second = self.second[: len(change)]
    slopes = np.bincount(second, -residual * change)[np.unique(second)]
    return tuple(float(f"{s:.3g}") for s in slopes / max(float(np.linalg.norm(change)), 1e-12))

  def _estimates(self, model: Candidate, name: str) -> tuple[Estimate, ...]:
    values = model.free.named(model.values)
    scatter = model.free.named(clustered_std(model, self.observations))
    declared = [p for p in self.pool.problem.mechanism(name).parameters if p.name in model.free]
    row = lambda p: Estimate(p.name, values[p.name], scatter[p.name], p.unit, p.null)
    return tuple(row(p) for p in declared)

  def _test(self, larger: Candidate, smaller: Candidate) -> Comparison:
    return compare(larger, smaller, self.observations)


def measured_figures(model: Candidate, twin: Twin, observations: Observations | None = None) -> tuple[Measured, ...]:
  """Figures that the vehicle states a deviation of, and the ages of sensors, as a model has them."""
  values = model.free.named(model.values)
  figures = [p for p in model.free if p.kind == "measured" and p.null is None and p.std]
  size = lambda p: size_of(p.unit, p.nominal, twin.period, twin.vehicle.cg_height)
  known = [Measured(p.name, p.nominal, p.std or 0.0, values[p.name], size(p), p.unit) for p in figures]
  errors = usual_errors(twin.mechanisms, observations)
  ages = [p for p in model.free if p.name in errors and p.unit == "s"]
  usual = [Measured(p.name, p.null or 0.0, errors[p.name], values[p.name], size(p), p.unit, True) for p in ages]
  return tuple(known + usual)


def _key(model: Candidate) -> frozenset[str]:
  return frozenset(model.mechanisms)


def _names(model: Candidate) -> tuple[str, ...]:
  return tuple(sorted(model.mechanisms))


def _held(model: Candidate, at: Mapping[str, float]) -> Candidate:
  """A model with some parameters held at values and the rest refitted within their bounds, to first order."""
  held = [model.free.index(n) for n in at]
  rest = [i for i in range(len(model.free)) if i not in held]
  move = np.zeros(len(model.free))
  move[held] = np.array(list(at.values())) - model.values[held]
  curvature = model.curvature
  pull = model.gradient + curvature @ move
  free = ParameterSet(model.free[model.free.names[i]] for i in rest)
  values = bounded_solve(curvature[np.ix_(rest, rest)], pull[rest], model.values[rest], free)
  move[rest] = values - model.values[rest]
  return dataclasses.replace(
    model,
    free=free,
    values=values,
    residual=model.residual + model.jacobian @ move,
    jacobian=model.jacobian[:, rest],
  )


def what_is_left(pool: Pool, mechanisms: Sequence[str]) -> list[Leftover]:
  """Structure in the residuals of a model of the pool."""
  model = pool.models[frozenset(mechanisms)]
  return leftovers(model, pool.problem, pool.problem.exact.predict(model.theta[None]))


def errors_left(fits: Mapping[str, ChannelFit], pool: Pool) -> tuple[list[Leftover], list[Leftover]]:
  """What two twins get wrong on recordings that were not fitted, before and after, of channels measured directly.

  An error need not follow anything that is looked at. Displacements are not asked: one slide of the car decides them.
  """
  observations = pool.problem.observations
  before, after = [], []
  for channel, fit in fits.items():
    noise = max(fit.noise_floor, fit.driving_noise)
    if not RESIDUALS[channel].is_direct or channel not in observations.present or noise <= 0.0:
      continue
    spread = float(np.std(observations.measured[observations.select(channel)]))
    for error, out in ((fit.before, before), (fit.after, after)):
      size = float(np.sqrt(max(error**2 - noise**2, 0.0))) / max(spread, 1e-12)
      follows = ("it need not follow anything",)
      out.append(Leftover(channel, "error", follows, error / noise, count=fit.samples, size=size))
  return before, after


def with_errors(found: Evidence, roles: Mapping[str, Mapping[str, ChannelFit]]) -> Evidence:
  """Evidence with the errors on recordings that took no part, by role and channel."""
  return dataclasses.replace(
    found,
    errors=rounded(
      tuple(held_out_error(role, name, fit) for role, fits in roles.items() for name, fit in fits.items())
    ),
  )
