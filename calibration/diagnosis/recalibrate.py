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
from calibration.fit import Fit, finite_differences, fit
from calibration.observations import Observations, observe
from calibration.segmenting import DEFAULT_CUT, Cut
from qcar_twin.parameters import ParameterSet
from qcar_twin.recording import Recording
from qcar_twin.twin import Twin

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

SENSOR_BIASES = {"accel_bias_x": 0.15, "accel_bias_y": 0.15, "gyro_bias": 0.02}  # m/s^2, m/s^2, rad/s
BIAS_MECHANISMS = ("accel_bias", "gyro_bias")


@dataclasses.dataclass(frozen=True)
class Baseline:
  """The recalibrated twin without any mechanism.

  Attributes:
    problem: residuals with the final weights.
    passport: noise of the sensors.
    fit: the base parameters' fit.
    theta: full parameter vector with every mechanism at its null, (P,).
    jacobian: d whitened residual / d base parameters over all values, fitted and judging, (M, p).
    shift: command timing that fitted best, control periods.
  """

  problem: Problem
  passport: Mapping[str, ChannelNoise]
  fit: Fit
  theta: Array
  jacobian: Array
  shift: int


def recalibrate(
  twin: Twin,
  recordings: Sequence[Recording],
  priors: ParameterSet | None = None,
  shifts: Sequence[int] = (0,),
  cut: Cut = DEFAULT_CUT,
  rounds: int = 1,
  progress: Callable[[str], None] = lambda text: None,
) -> Baseline:
  """Fit the base parameters to recordings.

  Args:
    twin: the car with the whole catalogue, all at null.
    recordings: those of role "validate" are not fitted; they only judge.
    priors: base parameters with better first guesses than the vehicle's nominal ones.
    shifts: command timings to try, control periods; more than one where the log's convention is unknown.
    cut: how recordings are cut.
    rounds: how often weights are taken anew from the residuals.
    progress: told what is being done.
  """
  recordings = sorted(recordings, key=lambda r: r.role == "validate")
  passport = noise_passport(recordings)
  base = priors or twin.base
  tried = []
  for shift in shifts:
    progress(f"recalibration, commands shifted by {shift}" if len(shifts) > 1 else "recalibration")
    observations = observe(recordings, twin.vehicle, dataclasses.replace(cut, shift=shift))
    tried.append(
      (shift, *_fit_base(twin, observations, fitted_count(observations, recordings), base, passport, rounds))
    )
  shift, problem, found, whole = min(tried, key=lambda t: _comparable_cost(t[1], t[2], tried[0][1]))
  theta = problem.embed(base.names, found.theta, problem.parameters.nominal)[0]
  return Baseline(problem, passport, found, theta, whole, shift)


def fitted_count(observations: Observations, recordings: Sequence[Recording]) -> int:
  """How many values, from the front, belong to recordings that are fitted."""
  judging = [i for i, r in enumerate(recordings) if r.role == "validate"]
  if len(judging) == len(recordings):
    raise ValueError('no recording has the role "identify"; give at least one that role in dataset.toml')
  return int(np.sum(~np.isin(observations.recording, judging)))


def with_sensor_biases(base: ParameterSet, twin: Twin) -> ParameterSet:
  """The base parameters and the small biases every IMU has, so that they are not taken for physics.

  A bias far beyond them is claimed as such; see decide.
  """
  biases = [dataclasses.replace(twin.parameters[n], std=s) for n, s in SENSOR_BIASES.items() if n in twin.parameters]
  return base + biases


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
  twin: Twin,
  observations: Observations,
  fitted: int,
  base: ParameterSet,
  passport: Mapping[str, ChannelNoise],
  rounds: int,
) -> tuple[Problem, Fit, Array]:
  floor = sensor_floor(passport)
  around = twin.parameters.nominal
  start = _best_start(twin, observations, fitted, base)
  problem = Problem(twin, observations, _flat_weighting(observations), fitted, base.names)
  theta = problem.embed(base.names, start, around)
  problem = problem.reweighted(weighting_from(observations, problem.raw(theta)[0], floor))
  found: Fit | None = None
  whole = np.zeros((len(observations), len(base)))
  for k in range(rounds + 1):
    residual = lambda v, p=problem: p.residual(p.embed(base.names, v, around))[:, :fitted]  # noqa: E731
    found = fit(residual, base, start, iterations=6 if k < rounds else 12, tolerance=1e-2 if k < rounds else 0.0, robust=np.inf,
                progress=lambda i, c, k=k: log.info("round %d iteration %d: cost %.1f", k, i, c))  # fmt: skip
    start = found.theta
    if k < rounds:
      theta = problem.embed(base.names, start, around)
      problem = problem.reweighted(weighting_from(observations, problem.raw(theta)[0], floor))
  assert found is not None
  everything = lambda v: problem.residual(problem.embed(base.names, v, around))  # noqa: E731
  whole = finite_differences(everything, base, found.theta, everything(found.theta[None])[0], 0.02)
  return problem, found, whole


def _flat_weighting(observations: Observations):
  """Weights that make every channel count by its own spread."""
  return weighting_from(observations, observations.measured, {})


def _best_start(twin: Twin, observations: Observations, fitted: int, base: ParameterSet) -> Array:
  """The best of a few guesses that differ in tyre stiffness; the drive's come from the log."""
  problem = Problem(twin, observations, _flat_weighting(observations), fitted)
  guesses = []
  for stiffness in (0.6, 1.6):
    guess = base.nominal
    for name in ("cornering_stiffness_front", "cornering_stiffness_rear"):
      guess[base.index(name)] *= stiffness
    guesses.append(np.clip(guess, base.lower, base.upper))
  guesses.append(base.nominal)
  residual = problem.residual(problem.embed(base.names, np.stack(guesses), twin.parameters.nominal))[:, :fitted]
  return guesses[int(np.argmin(np.sum(np.abs(residual), axis=1)))]


def _comparable_cost(problem: Problem, found: Fit, reference: Problem) -> float:
  """Cost with one common set of weights, so that fits with different weights compare."""
  count = len(found.residual)
  unscaled = found.residual / problem.whiten(np.ones(len(problem.observations)))[:count]
  return float(np.sum(np.abs(unscaled * reference.whiten(np.ones(len(reference.observations)))[:count])))
