"""What a diagnosis believes, as a mixture to draw cars from: models by probability, parameters by their covariance.

Every claim that is a mechanism of the model is there with its probability, one that can't be told from it with an equal
part of what they share, and nothing with the rest; claims are taken as independent. Of these sets those count that were
fitted, their probabilities taken up to 1. Where the repaired twin is not the one that is written, the recalibrated one
is all that is believed.
"""

import itertools
import math

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.decision.claims import Claim
from calibration.diagnosis.outcome import Diagnosis
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import scatter
from calibration.diagnosis.shipping import objections
from qcar_twin.twin.posterior import Believed, Posterior


def belief(diagnosis: Diagnosis) -> Posterior:
  """The mixture of a diagnosis."""
  pool = diagnosis.pool
  if objections(diagnosis):
    return Posterior((_believed(pool.base, pool, 1.0),))
  inside = set(diagnosis.decision.mechanisms)
  odds = [_odds(claim) for claim in diagnosis.decision.claims if claim.mechanism in inside]
  weights: dict[frozenset[str], float] = {}
  for chosen in itertools.product(*odds):
    key = frozenset(name for name, _ in chosen if name)
    weights[key] = weights.get(key, 0.0) + math.prod(probability for _, probability in chosen)
  fitted = {key: weight for key, weight in weights.items() if key in pool.models and weight > 0.0}
  total = sum(fitted.values())
  if not total:
    return Posterior((_believed(diagnosis.model, pool, 1.0),))
  return Posterior(tuple(_believed(pool.models[key], pool, weight / total) for key, weight in fitted.items()))


def _odds(claim: Claim) -> list[tuple[str, float]]:
  """What may stand for a claim, with its probability: itself, a name that fits as well, nothing."""
  others = claim.indistinguishable_from
  share = (claim.shared - claim.probability) / len(others) if others else 0.0
  present = [(claim.mechanism, claim.probability), *((name, max(share, 0.0)) for name in others)]
  return [*present, ("", max(0.0, 1.0 - sum(probability for _, probability in present)))]


def _believed(model: Candidate, pool: Pool, probability: float) -> Believed:
  covariance = scatter(model, pool.problem.observations).covariance()
  return Believed(model.mechanisms, probability, tuple(model.free.names), model.values, covariance)
