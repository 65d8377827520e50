"""What recalibration makes of sessions without an effect: parameters against their truth, and where poor starts end."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from calibration.concealed.proving_ground import Session
from calibration.diagnosis.pipeline import prepare
from calibration.diagnosis.pool import base_candidate
from calibration.diagnosis.score import clustered_std
from calibration.fitting.recalibration import RecalibratedTwin, settled_from
from qcar_twin.recordings.dataset import DataSet

LAGS = (1, 2, 3)
ONE = 2.0  # nats above the least cost within which a minimum is the same: a likelihood ratio of e^2
_POORER = (0.6, 1.6)  # times the tyres' stiffness and the motor's gain that recalibration begins with


@dataclasses.dataclass(frozen=True)
class Base:
  """A session's recalibrated twin.

  Attributes:
    error: of parameters that the generator states in the same sense, relative to their truth.
    score: the same in standard deviations, a sandwich over recordings.
    correlation: largest of neighbouring residuals at LAGS, over the channels.
    cost: at the minimum, nats.
    poor: costs where poor starts ended, nats.
  """

  error: Mapping[str, float]
  score: Mapping[str, float]
  correlation: float
  cost: float
  poor: tuple[float, ...]

  @property
  def in_one(self) -> int:
    """Poor starts that ended in the least minimum of all."""
    return sum(cost - min(self.cost, *self.poor) <= ONE for cost in self.poor)


def recalibrated_base(session: Session, poor: int = 0, substeps: int = 2) -> Base:
  """Recalibrate on a session, as a diagnosis does, and `poor` times more with other tyres and another motor."""
  begun = prepare(DataSet("session", session.recordings, session.vehicle, session.vehicle_std), substeps=substeps)
  recalibrated = begun.recalibrated
  model, observations = base_candidate(recalibrated), recalibrated.problem.observations
  std = model.free.named(clustered_std(model, observations))
  values, truth = model.free.named(model.values), stated(session.truth)
  starts = range(1, poor + 1)
  return Base(
    error={name: values[name] / true - 1.0 for name, true in truth.items()},
    score={name: (values[name] - true) / std[name] for name, true in truth.items()},
    correlation=max(_correlation(model.residual[observations.select(n)]) for n in observations.present),
    cost=recalibrated.fit.cost,
    poor=tuple(_from_poor_start(recalibrated, np.random.default_rng(k)) for k in starts),
  )


def stated(truth: Mapping) -> dict[str, float]:
  """Parameters of the twin that the generator states in the same sense, by name, SI."""
  car, linear = truth["car"], truth["linearised"]
  return {
    "cornering_stiffness_front": linear["cornering_stiffness_front"],
    "cornering_stiffness_rear": linear["cornering_stiffness_rear"],
    "longitudinal_stiffness": 4.0 * car["slip_stiffness"],
    "friction_coefficient": car["friction"],
    "relaxation_length": car["relaxation"],
    **{name: car[name] for name in ("mass", "yaw_inertia", "cg_to_front")},
  }


def _from_poor_start(recalibrated: RecalibratedTwin, random: np.random.Generator) -> float:
  """Cost of the same fit from other tyres and another motor, nats."""
  base = recalibrated.fit.parameters
  poor = ("cornering_stiffness_front", "cornering_stiffness_rear", "longitudinal_stiffness", "torque_per_volt")
  factors = {name: random.choice(_POORER) for name in poor if name in base}
  start = np.array([value * factors.get(name, 1.0) for name, value in base.named(base.nominal).items()])
  return float(settled_from(recalibrated, np.clip(start, base.lower, base.upper)).fit.cost)


def _correlation(values: np.ndarray) -> float:
  power = float(np.mean(values**2))
  return max(abs(float(np.mean(values[:-k] * values[k:])) / power) for k in LAGS)
