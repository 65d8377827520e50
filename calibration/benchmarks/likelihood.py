"""What the likelihood makes of sessions without an effect: whether what is left is white, and what pushed the car."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from calibration.diagnosis.considered import considered
from calibration.fitting.windows import Cut
from calibration.likelihood.body_force import BodyForce
from calibration.likelihood.noise import FITTED, first_noise
from calibration.likelihood.priors import base_priors
from calibration.likelihood.readings import read
from calibration.likelihood.refit import Minimum, refit
from calibration.proving_ground import Session
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

LAGS = (1, 2, 3)
_POORER = (0.6, 1.6)  # times the guessed tyre stiffness and motor gain, for poor starts


@dataclasses.dataclass(frozen=True)
class Whiteness:
  """Attributes:
  chi: mean square of the whitened residuals, per reading, with the trusts that were fitted.
  distrusted: share of (window, channel) whose precision is below half of the sensor's.
  correlation: of neighbouring readings within a window at LAGS, by channel.
  noise: numbers that were fitted.
  score: parameters minus truth in standard deviations.  error: relative.
  cost: at the minimum, nats.  spread: largest cost of poor starts minus the least, nats; NaN without poor starts.
  simulations: of the data.
  """

  chi: float
  distrusted: float
  correlation: Mapping[str, tuple[float, ...]]
  noise: Mapping[str, float]
  score: Mapping[str, float]
  error: Mapping[str, float]
  cost: float
  spread: float
  simulations: int


def whiteness(
  session: Session, seconds: float = np.inf, steps: int = 8, substeps: int = 5, poor: int = 0, gaussian: bool = False
) -> Whiteness:
  """Fit the base to a session's fitted recordings.

  Args:
    seconds: of driving at most.  steps: linearisations at most.  poor: further starts, with other tyres and motors.
    gaussian: every window is trusted alike.
  """
  dataset = DataSet("session", session.recordings, session.vehicle, session.vehicle_std)
  vehicle, fitted = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std), list(dataset.role("identify"))
  known = [*considered(None, None, vehicle.drive), BodyForce()]
  twin = Twin(vehicle, known, substeps=substeps, threads=1, engine="reduced")
  base, readings = base_priors(fitted, twin), read(fitted, vehicle, Cut(most=seconds))
  nominal, noise = twin.parameters.vector({p.name: p.nominal for p in base}), first_noise(fitted, readings)
  trusting = steps if gaussian else 2
  found, costs = refit(twin, readings, noise, base, nominal, readings.starts, steps, trusting=trusting), []
  for k in range(poor):
    start, rng = nominal.copy(), np.random.default_rng(k)
    for name in ("cornering_stiffness_front", "cornering_stiffness_rear", vehicle.motor.gain, "longitudinal_stiffness"):
      start[twin.parameters.index(name)] *= rng.choice(_POORER)
    costs.append(refit(twin, readings, noise, base, start, readings.starts, steps, trusting=trusting).cost)
  left = found.place.left_over(*found.place.smoothed(found.noise, found.place.residual, found.place.gap, found.starts))
  score, error = _against(found, session.truth)
  return Whiteness(
    chi=float(np.sum(found.white.rows(0) ** 2) / readings.used.sum()),
    distrusted=float(np.mean(found.noise.trust < 0.5)),
    correlation={
      name: _correlation(left[:, readings.channel == c])
      for c, name in enumerate(readings.channels)
      if np.sum(readings.channel == c) > max(LAGS)
    },
    noise={name: found.noise.value(name) for name in FITTED},
    score=score,
    error=error,
    cost=found.cost,
    spread=max([*costs, found.cost]) - min([*costs, found.cost]) if costs else np.nan,
    simulations=found.simulations,
  )


def _correlation(rows: np.ndarray) -> tuple[float, ...]:
  power = float(np.mean(rows**2))
  return tuple(float(np.mean(rows[:, :-k] * rows[:, k:])) / power for k in LAGS)


def _against(found: Minimum, truth: Mapping) -> tuple[dict[str, float], dict[str, float]]:
  """Parameters that the generator states in the same sense, against their truth."""
  car, linear = truth["car"], truth["linearised"]
  stated = {name: linear[name] for name in ("cornering_stiffness_front", "cornering_stiffness_rear")}
  stated |= {
    "longitudinal_stiffness": 4.0 * car["slip_stiffness"],
    "friction_coefficient": car["friction"],
    "relaxation_length": car["relaxation"],
  }
  stated |= {name: car[name] for name in ("mass", "yaw_inertia", "cg_to_front")}
  values = dict(zip(found.free.names, zip(found.values, found.std, strict=True), strict=True))
  return (
    {n: float((values[n][0] - x) / values[n][1]) for n, x in stated.items()},
    {n: float(values[n][0] / x - 1.0) for n, x in stated.items()},
  )
