"""S1, honest recalibration: the best the twin can do with the physics it has.

Everything that follows is measured against this fit, never against an uncalibrated twin. Weights
come from the noise passport at first and from the fit's own residuals afterwards, so that a channel
full of road noise does not drown the others.
"""

import dataclasses
import logging
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.passport import ChannelNoise, noise_passport
from calibration.diagnosis.problem import Problem, weighting_from
from calibration.fit import Fit, fit
from calibration.observations import Observations, observe
from calibration.segmenting import Cut
from qcar_twin.parameters import ParameterSet
from qcar_twin.recording import Recording
from qcar_twin.twin import Twin

Array = NDArray[np.float64]

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Baseline:
  """The recalibrated twin without any mechanism.

  Attributes:
    problem: residuals with the final weights.
    passport: noise of the sensors.
    fit: the base parameters' fit.
    theta: full parameter vector with every mechanism at its null, (P,).
    shift: command timing that fitted best, control periods.
  """

  problem: Problem
  passport: Mapping[str, ChannelNoise]
  fit: Fit
  theta: Array
  shift: int


def recalibrate(
  twin: Twin,
  recordings: Sequence[Recording],
  priors: ParameterSet | None = None,
  shifts: Sequence[int] = (0,),
  cut: Cut = Cut(),
  rounds: int = 2,
  progress: Callable[[str], None] = lambda text: None,
) -> Baseline:
  """Fit the base parameters to recordings.

  Args:
    twin: the car with the whole catalogue, all at null.
    recordings: what to fit.
    priors: base parameters with better first guesses than the vehicle's nominal ones.
    shifts: command timings to try, control periods; more than one where the log's convention is unknown.
    cut: how recordings are cut.
    rounds: how often weights are taken anew from the residuals.
    progress: told what is being done.
  """
  passport = noise_passport(recordings)
  base = priors or twin.base
  tried = []
  for shift in shifts:
    progress(f"recalibration, commands shifted by {shift}" if len(shifts) > 1 else "recalibration")
    observations = observe(recordings, twin.vehicle, dataclasses.replace(cut, shift=shift))
    tried.append((shift, *_fit_base(twin, observations, base, passport, rounds)))
  shift, problem, found = min(tried, key=lambda t: _comparable_cost(t[1], t[2], tried[0][1]))
  return Baseline(problem, passport, found, problem.embed(base.names, found.theta, problem.parameters.nominal)[0], shift)


def sensor_floor(passport: Mapping[str, ChannelNoise], horizon: float = 1.0) -> dict[str, float]:
  """Smallest standard deviation a residual channel can have: the sensor's own noise."""
  floor = {name: noise.std for name, noise in passport.items()}
  if "pose_x" in passport and "pose_y" in passport:
    position = float(np.hypot(passport["pose_x"].std, passport["pose_y"].std))
    floor["pose_forward"] = floor["pose_left"] = position
  if "pose_yaw" in passport:
    floor["pose_turn"] = float(np.sqrt(2.0) * passport["pose_yaw"].std)
  return floor


def _fit_base(
  twin: Twin, observations: Observations, base: ParameterSet, passport: Mapping[str, ChannelNoise], rounds: int
) -> tuple[Problem, Fit]:
  floor = sensor_floor(passport)
  names = base.names
  around = twin.parameters.nominal
  start = _best_start(twin, observations, base)
  raw = Problem(twin, observations, _flat_weighting(observations)).raw
  weighting = weighting_from(observations, raw(_full(twin, names, start, around))[0], floor)
  found: Fit | None = None
  problem = Problem(twin, observations, weighting)
  for k in range(rounds + 1):
    problem = Problem(twin, observations, weighting)
    guess = start if found is None else found.theta
    found = fit(lambda v: problem.residual(problem.embed(names, v, around)), base, guess,
                iterations=10 if k == 0 else 4, robust=np.inf,
                progress=lambda i, c: log.info('round %d iteration %d: cost %.1f', k, i, c))  # fmt: skip
    if k < rounds:
      unscaled = found.residual / problem.whiten(np.ones(len(observations)))
      weighting = weighting_from(observations, unscaled, floor)
  assert found is not None
  return problem, found


def _full(twin: Twin, names: Sequence[str], values: Array, around: Array) -> Array:
  full = around.copy()
  full[[twin.parameters.index(n) for n in names]] = values
  return full[None]


def _flat_weighting(observations: Observations):
  """Weights that make every channel count by its own spread."""
  return weighting_from(observations, observations.measured, {})


def _best_start(twin: Twin, observations: Observations, base: ParameterSet) -> Array:
  """The best of a few guesses that differ in motor strength, damping and tyre stiffness."""
  problem = Problem(twin, observations, _flat_weighting(observations))
  guesses = []
  for strength in (0.6, 1.0, 1.6):
    for stiffness in (0.6, 1.6):
      guess = base.nominal
      for name in ("torque_per_volt", "motor_damping"):
        guess[base.index(name)] *= strength
      for name in ("cornering_stiffness_front", "cornering_stiffness_rear"):
        guess[base.index(name)] *= stiffness
      guesses.append(np.clip(guess, base.lower, base.upper))
  guesses.append(base.nominal)
  residual = problem.residual(problem.embed(base.names, np.stack(guesses), twin.parameters.nominal))
  return guesses[int(np.argmin(np.sum(np.abs(residual), axis=1)))]


def _comparable_cost(problem: Problem, found: Fit, reference: Problem) -> float:
  """Cost with one common set of weights, so that fits with different weights compare."""
  unscaled = found.residual / problem.whiten(np.ones(len(problem.observations)))
  return float(np.sum(np.abs(reference.whiten(unscaled[: len(reference.observations)]))))
