"""The bicycle fitted to recordings, where there are no steps to identify it from in the paper's way.

The same maximum a posteriori as the twin's: five parameters, first values of the drive from the log, residuals
weighted by each channel's own size of error.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.first_guess import first_guess
from calibration.fitting.likelihood import weighting_from
from calibration.fitting.noise import noise_models
from calibration.fitting.noise_floor import sensor_floor
from calibration.fitting.observations import observe
from calibration.fitting.optimiser import Fit, fit
from calibration.fitting.windows import Cut
from calibration.progress import Progress, silent
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.parameters import ParameterSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.parameters import drive_response, informed
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

ROUNDS = 2  # weights are taken from the residuals, fitted with, and taken once more


def fit_bicycle(
  recordings: Sequence[Recording],
  vehicle: Vehicle,
  cut: Cut,
  progress: Progress = silent,
) -> Fit:
  """P1, P2, P3, C_f, C_r from recordings of any manoeuvre; the roles "identify" and none else should be given."""
  bicycle = Bicycle(vehicle)
  priors = starting_values(recordings, vehicle)
  observations = observe(recordings, vehicle, cut)
  segments, floor = observations.stretches.segments, sensor_floor(noise_models(recordings))

  def raw(theta: Array) -> Array:
    wrong = observations.predict(bicycle.rollout(theta, segments)) - observations.measured
    return np.nan_to_num(wrong, nan=1e3, posinf=1e3, neginf=-1e3)

  estimate: Fit | None = None
  start = priors.nominal
  for k in range(ROUNDS):
    weighting = weighting_from(observations, raw(start[None])[0], floor)
    scale = weighting.scale(observations.channel)
    about = f"bicycle on recordings, round {k + 1}"
    tell = lambda i, cost, about=about: progress(f"{about}, iteration {i}, cost {cost:.0f}")
    estimate = fit(lambda v, s=scale: raw(v) * s, priors, start, iterations=8, robust=np.inf, progress=tell)
    start = estimate.theta
  assert estimate is not None
  return estimate


def starting_values(recordings: Sequence[Recording], vehicle: Vehicle) -> ParameterSet:
  """The bicycle's parameters with values of the drive from the log and stiffness typical of the car's weight."""
  guess = drive_response(vehicle, first_guess(recordings, vehicle))
  values = dict(zip(("drive_gain", "drive_damping", "drive_friction"), guess, strict=True))
  values |= {name: getattr(vehicle, name) for name in ("cornering_stiffness_front", "cornering_stiffness_rear")}
  return informed(Bicycle(vehicle).parameters, {name: float(value) for name, value in values.items()})
