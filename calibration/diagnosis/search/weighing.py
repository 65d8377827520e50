"""What a name is worth: four figures of a refit, and the probability that names with such figures were right.

    logit P = constant + t min(|t|, most_t) sign(t) + size ln(share of the typical size) + margin l(nats ahead)
    l(n) = sign(n) ln(1 + |n| / near)

The four weights are fitted to answers of campaigns by `qcar-twin set-levels`; what every number is and where it comes
from stands in levels.toml.
"""

import dataclasses
import functools
import math
import tomllib
from pathlib import Path

import numpy as np
from scipy import stats

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, compare, errors_taken_off, prior_part

FILE = Path(__file__).with_name("levels.toml")


@dataclasses.dataclass(frozen=True)
class Levels:
  """The numbers that decide what is claimed, and whether something is left.

  Attributes:
    constant, t, size, margin: weights of the logistic.
    most_t: held-out t beyond which more of it tells nothing.
    least_size: share of the typical size below which all are alike.
    near: nats between two fits of a likelihood ratio of 20.
    claim: probability from which a name is claimed.
    gain: share that a name must take off the held-out error of some channel.
    conflict: chance that parameters of some name part that far from what was measured of the car.
    spread: errors of fitted parameters over their stated deviations.
    bias: share of the typical size from which the bias of a sensor is one.
    equivalent: held-out t of a claim over a rival below which the two can't be told apart.
    form: standard deviation of a claimed size for the formula's own error, as a share of it.
    chance: probability under noise from which on smooth structure of a channel is none.
    material: share of a channel's spread from which on it matters: with quiet sensors the twin's own simplifications
      become visible.
    rhythm: probability under a smooth spectrum from which on a line is none.
    bursts: odds that an error falls into the few strongest moments from which on they are bursts.
    error: multiple of a sensor's noise while driving from which on an error where nothing was fitted is more than that.
    remains: part of the recalibrated twin's own leftover that may remain beside a right name: a formula right in kind
      is not right in every detail.
    doubt: what a probability is multiplied by where more remains.
  """

  constant: float
  t: float
  size: float
  margin: float
  most_t: float
  least_size: float
  near: float
  claim: float
  gain: float
  conflict: float
  spread: float
  bias: float
  equivalent: float
  form: float
  chance: float
  material: float
  rhythm: float
  bursts: float
  error: float
  remains: float
  doubt: float

  def figures(self, t: float, size: float, margin: float) -> tuple[float, float, float]:
    """What the weights t, size and margin multiply."""
    return (
      max(-self.most_t, min(t, self.most_t)),
      math.log(max(self.least_size, min(size, 1.0))),
      math.copysign(math.log1p(abs(margin) / self.near), margin),
    )

  def probability(self, t: float, size: float, margin: float) -> float:
    """That a name is right.

    Args:
      t: held-out gain over its standard error, with what the priors gain.
      size: share of the typical size that the driving shows.
      margin: nats by which it fits better than nothing, or than the best other name in its place, in its priors, too.
    """
    parts = zip((self.t, self.size, self.margin), self.figures(t, size, margin), strict=True)
    return 1.0 / (1.0 + math.exp(-self.constant - sum(weight * part for weight, part in parts)))


def read_levels(file: Path = FILE) -> Levels:
  """The levels of a file.

  Raises:
    ValueError: a level is missing, unknown or without a source.
  """
  table = tomllib.loads(file.read_text(encoding="utf-8"))
  known = {f.name for f in dataclasses.fields(Levels)}
  if set(table) != known:
    raise ValueError(f"{file.name}: levels must be {', '.join(sorted(known))}; it has {', '.join(sorted(table))}")
  for name, entry in table.items():
    if not entry.get("source"):
      raise ValueError(f"{file.name}: level '{name}' has no source; say where its value comes from")
  return Levels(**{name: float(entry["value"]) for name, entry in table.items()})


@functools.cache
def usual_levels() -> Levels:
  """Those of levels.toml."""
  return read_levels()


@dataclasses.dataclass(frozen=True)
class Weighed:
  """A name in a model against the model without it.

  Attributes:
    held_out: the two compared on groups left out.
    size: largest amplitude that the driving shows, as a share of its typical size.
    drop: nats by which the model fits better with it, priors included.
    alternatives: what was fitted in its place, with the nats it brings there, best first.
  """

  held_out: Comparison
  size: float
  drop: float
  alternatives: tuple[tuple[str, float], ...]

  @property
  def t(self) -> float:
    """Held-out gain over its standard error, with what the priors gain: there absorbed effects show."""
    return self.held_out.t_with_priors

  def margin(self, leaving_out: tuple[str, ...] = ()) -> float:
    """Nats ahead of the best rival but for some, or of nothing."""
    others = (nats for name, nats in self.alternatives if name not in leaving_out)
    return self.drop - max(0.0, max(others, default=0.0))


def weighed(pool: Pool, model: Candidate, name: str) -> Weighed:
  """A name weighed; the pool has the model without it."""
  rest = frozenset(model.mechanisms) - {name}
  without = pool.models[rest]
  beside = [
    (next(iter(key - rest)), without.cost - other.cost)
    for key, other in pool.models.items()
    if len(key) == len(model.mechanisms) and rest < key and name not in key
  ]
  return Weighed(
    held_out=compare(model, without, pool.problem.observations),
    size=shown_size(pool, model, name),
    drop=without.cost - model.cost,
    alternatives=tuple(sorted(beside, key=lambda r: -r[1])),
  )


def matters(pool: Pool, model: Candidate, without: Candidate, levels: Levels) -> bool:
  """Whether a name makes a difference that is no chance: to an error, or to what was measured of the car.

  Either it takes `gain` or more off some held-out channel's error, the blocks' gains being above zero (95 %),
  or without it parameters lie z * `spread` deviations or more from what was measured, z being the normal quantile at
  which that happens by chance to any of the names tried with probability `conflict`.
  """
  blocks = len(np.unique(pool.problem.observations.block))
  least = float(stats.t.ppf(0.95, max(blocks - 1, 1)))
  found = errors_taken_off(model, without, pool.problem.observations).values()
  if any(share >= levels.gain and t >= least for share, t in found):
    return True
  z = float(stats.norm.isf(0.5 * levels.conflict / max(len(pool.signatures), 1)))
  freed = prior_part(without) - prior_part(model)
  return freed >= 0.5 * (z * levels.spread) ** 2


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

  What it then makes up for is more often something else.
  """
  for p in pool.problem.mechanism(name).parameters:
    if p.null is None or p.name not in model.free:
      continue
    value, std = model.estimate(p.name)
    if any(abs(value - bound) < max(std, 1e-6 * p.scale) for bound in (p.lower, p.upper) if bound != p.null):
      return True
  return False
