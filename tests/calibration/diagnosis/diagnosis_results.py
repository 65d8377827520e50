"""Decisions and whole diagnoses put together by hand, for what writes and shows them."""

import dataclasses
from types import SimpleNamespace

import numpy as np

from calibration.diagnosis.decision.claims import Claim, claim
from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.conclude import conclude, judged
from calibration.diagnosis.decision.decide import Decision, decide
from calibration.diagnosis.decision.evidence import Evidence, Model
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.holdout_errors import ChannelFit, Replay
from calibration.diagnosis.locate import locate
from calibration.diagnosis.outcome import Diagnosis
from calibration.diagnosis.search.gather import Weighing, gather, what_is_left
from qcar_twin.twin.mechanisms import catalogue

HELD: Comparison = SimpleNamespace(gain=120.0, total=120.0, t=5.0, share_positive=0.9)  # type: ignore[assignment]


def claim_of(mechanism, equivalent=(), gain=300.0):
  """A claim whose parameters have their typical size, known to a twentieth."""
  parameters = {}
  for p in mechanism.parameters:
    size = p.typical or 0.1
    value = size if p.null is None else p.null + size
    parameters[p.name] = {"value": value, "std": size / 20.0, "unit": p.unit}
  rivals = tuple((name, 0.5 * gain) for name in equivalent) or (("steering_lag", 100.0),)
  return Claim(mechanism.name, 0.97, 0.97, gain, HELD, parameters, rivals, tuple(equivalent), True)


def decision_of(verdict, claimed, equivalent=(), unknown=None, model=None, ranking=()):
  """A decision with claims of typical size."""
  certain = verdict != "partly_explained"  # what has no name throws doubt on all that have one
  claims = tuple(dataclasses.replace(claim_of(catalogue()[n], equivalent), certain=certain) for n in claimed)
  ranked = ranking or tuple((c.mechanism, c.evidence_nats) for c in claims)
  behind = tuple(sorted(claimed if model is None else model.mechanisms))
  return Decision(verdict, claims, (), behind, (unknown, HELD) if unknown else None, ranked)


def replay_of(pool, model):
  """The fitted recordings as if they had been held out, with a model and the same without each of its mechanisms."""
  observations = pool.problem.observations
  raw = lambda m: m.residual / pool.problem.whiten(np.ones(len(observations)))
  key = frozenset(model.mechanisms)
  return Replay(observations, raw(pool.base), raw(model), {n: raw(pool.models[key - {n}]) for n in key})


def diagnosis_of(pool, claimed=(), verdict="explained", unknown=None, **changes):
  """A whole diagnosis of a pool of the linear car."""
  model = pool.models[frozenset(claimed)]
  ranking = tuple(sorted(((n, s.gain) for n, s in pool.signatures.items()), key=lambda kv: -kv[1]))
  decision = decision_of(verdict, claimed, unknown=unknown, model=model, ranking=ranking)
  fits = {
    "yaw_rate": ChannelFit(0.2, 0.16, 0.15, 0.15, (-0.3, -0.1), "rad/s", 900),
    "accel_y": ChannelFit(0.7, 0.52, 0.5, 0.5, (-0.35, -0.2), "m/s^2", 900),
  }
  values: dict[str, object] = {
    "dataset": "linear car",
    "decision": decision,
    "location": locate(pool, model, {"unknown_steering": 80.0, "unknown_force_y": 20.0}),
    "pool": pool,
    "evidence": Evidence("linear car", (Model((), 0.0),), ()),
    "validate": fits,
    "holdout": fits,
    "replay": replay_of(pool, model),
    "seconds": 12.5,
    "stages": {"recalibration": 8.0, "scan": 3.0, "search": 1.5},
  }
  return Diagnosis(**(values | changes))  # type: ignore[arg-type]


# claims at less: what holds of any weights shows on a short drive of the linear car
EASY = dataclasses.replace(usual_levels(), constant=usual_levels().constant + 3.0)


def decided(pool, levels=None):
  """What the evidence of a pool says."""
  return decide(gather(pool), levels)


def claimed_of(pool, model, name, levels=None):
  """A name of a model as a claim, likely or not."""
  weighing = Weighing(pool)
  weighed = weighing.model(model, [pool.base])
  named = next(n for n in weighed.names if n.name == name)
  return claim(named, weighed, gather(pool), levels or usual_levels())


def concluded(pool, decision, levels=None):
  evidence, levels = gather(pool).with_left((), what_is_left(pool, ())), levels or usual_levels()
  model = judged(decision, evidence, levels)
  return conclude(decision, evidence.with_left(model, what_is_left(pool, model)), levels)
