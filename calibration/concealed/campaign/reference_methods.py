"""Four simpler ways to judge the same recordings, for comparison on the same cases.

* recalibration alone: fit what there is and name nothing;
* unprofiled ranking: correlate each mechanism's effect with the residual, without asking what
  recalibration could absorb, and name the best;
* white-noise BIC: take every sample for an independent witness and the model with the lowest
  n ln(S / n) + p ln n (Schwarz 1978);
* boosted trees: learn the residual of each channel from state and command, and name nothing.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.black_box import boosted_residual, rms
from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.scan import Signature
from calibration.fitting.likelihood import Problem
from calibration.fitting.observations import observe
from calibration.fitting.windows import DEFAULT_CUT, Cut
from qcar_twin.plant import Prediction
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

METHODS = ("recalibration", "unprofiled_ranking", "white_noise_bic", "boosted_trees")
_LEAST = 20.0  # nats below which the unprofiled ranking names nothing; the same as for a claim of the diagnosis


@dataclasses.dataclass(frozen=True)
class Answer:
  """What a baseline says.

  Attributes:
    method: one of METHODS.
    claims: mechanisms it names.
    ranking: mechanism and score, best first; () where the method ranks nothing.
    holdout: RMS error per channel on the held-out recordings, in the channel's unit; {} where it predicts nothing.
  """

  method: str
  claims: tuple[str, ...]
  ranking: tuple[tuple[str, float], ...]
  holdout: dict[str, float]


def run_baselines(pool: Pool, holdout: Sequence[Recording], cut: Cut = DEFAULT_CUT) -> dict[str, Answer]:
  """All four on one case.

  Args:
    pool: of the diagnosis, for the recalibrated twin, the scan and the refitted models.
    holdout: held-out recordings.
    cut: how recordings are cut; the timing that was fitted.
  """
  base, problem = pool.base, pool.problem.exact
  ranking = unprofiled_ranking(pool.signatures)
  order = bic_ranking(pool)
  chosen = pool.models[order[0][0]]
  named = (ranking[0][0],) if ranking and ranking[0][1] >= _LEAST else ()
  errors: dict[str, dict[str, float]] = {method: {} for method in METHODS}
  if holdout:
    seen = observe(holdout, problem.twin.vehicle, cut)
    both = problem.twin.rollout(np.stack([base.theta, chosen.theta]), seen.stretches.segments)
    raw = seen.predict(both) - seen.measured
    errors["recalibration"], errors["white_noise_bic"] = rms(seen, raw[0]), rms(seen, raw[1])
    training = (problem.observations, problem.predict(base.theta[None]), raw_residual(problem, base))
    errors["boosted_trees"] = rms(seen, boosted_residual(*training, seen, _first(both), raw[0]))
  singles = tuple((next(iter(key)), -score) for key, score in order if len(key) == 1)
  return {
    "recalibration": Answer("recalibration", (), (), errors["recalibration"]),
    "unprofiled_ranking": Answer("unprofiled_ranking", named, ranking, errors["unprofiled_ranking"]),
    "white_noise_bic": Answer("white_noise_bic", chosen.mechanisms, singles, errors["white_noise_bic"]),
    "boosted_trees": Answer("boosted_trees", (), (), errors["boosted_trees"]),
  }


def unprofiled_ranking(signatures: Mapping[str, Signature]) -> tuple[tuple[str, float], ...]:
  """Mechanisms by the nats their whole effect, scaled freely, takes off the recalibrated residual, best first."""
  return tuple(sorted(((n, s.unprofiled) for n, s in signatures.items()), key=lambda kv: -kv[1]))


def bic_ranking(pool: Pool) -> list[tuple[frozenset[str], float]]:
  """All models with their white-noise BIC, lowest first."""
  scores = {key: white_noise_bic(pool.problem, model) for key, model in pool.models.items()}
  return sorted(scores.items(), key=lambda kv: kv[1])


def white_noise_bic(problem: Problem, model: Candidate) -> float:
  """sum_c n_c ln(S_c / n_c) + p ln n over the fitted values, every one taken for independent."""
  raw = raw_residual(problem, model)[: model.n_train]
  channel = problem.observations.channel[: model.n_train]
  total = len(model.free) * np.log(max(len(raw), 1))
  for index in np.unique(channel):
    square = raw[channel == index] ** 2
    total += len(square) * np.log(max(float(square.mean()), 1e-300))
  return float(total)


def raw_residual(problem: Problem, model: Candidate) -> Array:
  """Predicted minus measured in each channel's unit, (M,); the model must carry the problem's weights."""
  return model.residual / problem.whiten(np.ones(len(problem.observations)))


def _first(prediction: Prediction) -> Prediction:
  return Prediction(prediction.signals[:1], prediction.period)
