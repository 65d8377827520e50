"""A claim: a mechanism that is held responsible, with its evidence, its alternatives and its estimates."""

import dataclasses
import math

from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.departures import departures
from calibration.diagnosis.decision.evidence import Evidence, Model, Named
from calibration.diagnosis.decision.levels import Levels
from calibration.diagnosis.decision.weighing import alike, counts, part, probability


@dataclasses.dataclass(frozen=True)
class Claim:
  """One mechanism that is held responsible.

  Attributes:
    mechanism: id.
    probability: that the name is right, 0 to 1.
    shared: that it or one of `indistinguishable_from` is.
    evidence_nats: by which the model fits better than the one without it, priors included.
    held_out: the same comparison on recordings left out.
    parameters: value, std and unit of each of its parameters.
    alternatives: what fitted in its place, with its nats, best first.
    indistinguishable_from: alternatives that fit as well.
    certain: False if what is left over throws doubt on the name, and has lowered both probabilities.
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


def claim(name: Named, model: Model, evidence: Evidence, levels: Levels) -> Claim:
  """One mechanism of a model, weighed against the model without it and against what fits in its place.

  Names that can't be told apart have one probability together, as if the others were not there, since that several fit
  does not make it less likely that something is; of it each has at most its part by its own odds. A name that was
  stretched as far as it may, or that does not count, is none.
  """
  equivalent = tuple(a.name for a in alike(name, levels))
  shared = probability(name, levels, equivalent) * (not name.at_bound and counts(name, model, evidence, levels))
  return Claim(
    mechanism=name.name,
    probability=min(probability(name, levels), part(name, levels) * shared),
    shared=shared,
    evidence_nats=name.held_out.drop,
    held_out=name.held_out,
    parameters=_estimates(name, levels),
    alternatives=tuple((a.name, a.nats) for a in name.best_first),
    indistinguishable_from=equivalent,
    certain=True,
  )


def seen(claim: Claim, model: Model, evidence: Evidence, levels: Levels) -> Claim:
  """A claim of a model once it is known what it does to the error on held-out recordings.

  What a wrong name explains is often not there in other driving; so it is doubted, with the names like it.
  """
  ratio = evidence.held_out_ratio(model.mechanisms, claim.mechanism)
  after = lambda probability: levels.after_holdout(probability, ratio)
  return dataclasses.replace(claim, probability=after(claim.probability), shared=after(claim.shared))


def sensor_claims(model: Model, evidence: Evidence, levels: Levels) -> list[Claim]:
  """Errors far beyond what every sensor has. All models have them, so the test is to hold them to what is usual.

  How far an age lies beyond is judged with the form deviation that ages have, see `departures`, and that of a bias by
  `beyond_usual`.
  """
  ages = {figure.name for figure in model.measured if figure.usual}
  apart = {departure.name for departure in departures(model.measured, levels)}
  claims = []
  for name in model.sensors:
    parameters = {e.name for e in name.estimates}
    if not (parameters & apart if parameters & ages else beyond_usual(name, levels)):
      continue
    likely = levels.probability(name.t, name.held_out.drop)
    if likely >= levels.claim and counts(name, model, evidence, levels):
      test, estimates = name.held_out, _estimates(name, levels)
      claims.append(Claim(name.name, likely, likely, test.drop, test, estimates, (), (), True))
  return claims


def beyond_usual(name: Named, levels: Levels) -> bool:
  """Whether the biases together exceed the standard deviation that every such sensor is believed to have.

  Not that of its prior: where the gyro was read at rest, this says how well its bias is known and not how usual it is.
  Together, since a bias of 0.2 m/s^2 halfway between two axes is no smaller than one along either.
  """
  sizes = name.deviations
  return not sizes or math.hypot(*sizes) > levels.usual_reach(len(sizes))


def _estimates(name: Named, levels: Levels) -> dict[str, dict[str, float | str]]:
  """Value, standard deviation and unit of a mechanism's parameters; the deviation holds the formula's own error."""
  form = lambda e: 0.0 if e.null is None else levels.form * abs(e.value - e.null)
  row = lambda e: {"value": e.value, "std": math.hypot(e.std, form(e)), "unit": e.unit}
  return {e.name: row(e) for e in name.estimates}
