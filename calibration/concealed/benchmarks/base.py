"""What recalibration makes of sessions without an effect: parameters against their truth, and where poor starts end."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibration.concealed.benchmarks.known import stated
from calibration.concealed.laboratory.written import Session
from calibration.diagnosis.pipeline import prepare
from calibration.diagnosis.pool import base_candidate
from calibration.diagnosis.score import clustered_std
from calibration.fitting.recalibration import RecalibratedTwin, settled_from
from calibration.twin_calibration import calibrate
from qcar_twin.recordings.dataset import DataSet

LAGS = (1, 2, 3)
INSIDE = 1.645  # standard deviations: a 90 % interval
ONE = 2.0  # nats above the least cost within which a minimum is the same: a likelihood ratio of e^2
_POORER = (0.6, 1.6)  # times the tyres' stiffness and the motor's gain that recalibration begins with


@dataclasses.dataclass(frozen=True)
class Base:
  """A session's recalibrated twin.

  Attributes:
    error: of parameters that the generator states in the same sense, relative to their truth.
    score: the same in the standard deviations that a calibration states.
    alone: the same in those of the fit without the twin's form, a sandwich over recordings.
    correlation: largest of neighbouring residuals at LAGS, over the channels.
    cost: at the minimum, nats.
    poor: costs where poor starts ended, nats.
  """

  error: Mapping[str, float]
  score: Mapping[str, float]
  alone: Mapping[str, float]
  correlation: float
  cost: float
  poor: tuple[float, ...]

  @property
  def in_one(self) -> int:
    """Poor starts that ended in the least minimum of all."""
    return sum(cost - min(self.cost, *self.poor) <= ONE for cost in self.poor)


def recalibrated_base(car: str, session: Session, poor: int = 0) -> Base:
  """Calibrate on a session as a diagnosis recalibrates, and `poor` times more from other tyres and another motor.

  Args:
    car: that was driven, one that `stated` knows.
    session: without an effect.
    poor: further starts.
  """
  data = DataSet("session", session.recordings, session.vehicle, session.vehicle_std)
  begun = prepare(data)
  recalibrated, truth = begun.recalibrated, stated(car, session.truth)
  model, observations = base_candidate(recalibrated), recalibrated.problem.observations
  estimates = calibrate(data, "recordings", recalibrated=lambda: recalibrated).estimates
  std, starts = model.free.named(clustered_std(model, observations)), range(1, poor + 1)
  return Base(
    error={name: estimates[name].value / true - 1.0 for name, true in truth.items()},
    score={name: (estimates[name].value - true) / estimates[name].std for name, true in truth.items()},
    alone={name: (estimates[name].value - true) / std[name] for name, true in truth.items()},
    correlation=max(_correlation(model.residual[observations.select(n)]) for n in observations.present),
    cost=recalibrated.fit.cost,
    poor=tuple(_from_poor_start(recalibrated, np.random.default_rng(k)) for k in starts),
  )


def by_parameter(fits: Sequence[Base]) -> list[str]:
  """A line for each parameter: how often its interval holds the truth, and its mean error."""
  scores: dict[str, list[tuple[float, float]]] = {}
  for one in fits:
    for name, z in one.score.items():
      scores.setdefault(name, []).append((z, one.error[name]))
  return [
    f"{name}: {sum(abs(z) <= INSIDE for z, _ in rows)} of {len(rows)}, in the mean {np.mean([e for _, e in rows]):+.1%}"
    for name, rows in scores.items()
  ]


def base_row(car: str, seed: int, fitted: Base) -> tuple[str, ...]:
  """One session's line of the page."""
  return (
    f"{car} {seed}",
    ", ".join(f"{name} {100 * e:+.1f} ({fitted.score[name]:+.1f})" for name, e in fitted.error.items()),
    f"{sum(abs(z) <= INSIDE for z in fitted.score.values())} of {len(fitted.score)}",
    f"{fitted.in_one} of {len(fitted.poor)}",
    ", ".join(f"{cost - fitted.cost:+.1f}" for cost in fitted.poor),
    f"{fitted.correlation:.2f}",
  )


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
