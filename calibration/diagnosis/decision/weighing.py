"""What a name's evidence comes to: its probability, its part among names alike, and whether it makes a difference."""

import math

from scipy import stats

from calibration.diagnosis.decision.chance import beyond_chance
from calibration.diagnosis.decision.departures import departures
from calibration.diagnosis.decision.evidence import Alternative, Evidence, Model, Named
from calibration.diagnosis.decision.levels import Levels


def probability(name: Named, levels: Levels, leaving_out: tuple[str, ...] = ()) -> float:
  """That a name is right, as if some alternatives were not there."""
  return levels.probability(name.t, name.margin(leaving_out))


def alike(name: Named, levels: Levels) -> tuple[Alternative, ...]:
  """Alternatives that neither driving left out nor what was measured of the car tells from a name."""
  near = lambda a: a.behind_t < levels.equivalent and a.behind_priors < levels.near
  return tuple(a for a in name.best_first if near(a) and not a.at_bound)


def part(name: Named, levels: Levels) -> float:
  """A name's part of what it shares with names alike: its odds over all their odds."""
  own = _odds(probability(name, levels))
  return own / (own + sum(_odds(_probability_of(a, name, levels)) for a in alike(name, levels)))


def _probability_of(alternative: Alternative, name: Named, levels: Levels) -> float:
  """That an alternative is right, with the name itself among what it is weighed against."""
  others = [name.held_out.drop, *(a.nats for a in name.alternatives if a.name != alternative.name)]
  return levels.probability(alternative.t, alternative.nats - max(0.0, *others))


def _odds(value: float) -> float:
  return value / (1.0 - value)


def counts(name: Named, model: Model, evidence: Evidence, levels: Levels) -> bool:
  """Whether a name of a model that is likely enough may be claimed, by either of two kinds of evidence.

  Driving: it takes something off an error, see `matters`, and its seconds agree beyond chance. Or what was measured of
  the car, or is usual of its sensors, which the driving contradicts without it.
  """
  return (matters(name, levels) and beyond_chance(name, evidence, levels)) or reconciles(name, model, levels)


def matters(name: Named, levels: Levels) -> bool:
  """Whether a name makes a difference to the error on driving left out.

  It takes `gain` or more off some channel's error, the blocks' gains being above zero (`sure`), and takes more off all
  channels together than it adds, by the geometric mean of their errors.
  """
  least = float(stats.t.ppf(levels.sure, max(len(name.held_out.blocks) - 1, 1)))
  gains = any(e.share >= levels.gain and e.t >= least for e in name.errors)
  return gains and math.prod(1.0 - e.share for e in name.errors) < 1.0


def reconciles(name: Named, model: Model, levels: Levels) -> bool:
  """Whether a figure of the car departs without a name that does not with it, and none instead."""
  apart = {d.name for d in departures(model.measured, levels)}
  return apart < {d.name for d in departures(name.without, levels)}
