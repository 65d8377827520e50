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

from calibration.diagnosis.passport import ChannelNoise, means_at_rest, noise_passport
from calibration.diagnosis.problem import Problem, Weighting, weighting_from
from calibration.fit import Fit, finite_differences, fit
from calibration.observations import Observations, observe
from calibration.segmenting import DEFAULT_CUT, Cut
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.recording import Recording
from qcar_twin.twin import Twin

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

_BODY = ("mass", "yaw_inertia", "cg_to_front", "cg_height_offset")
# of the nominal friction, where rough fits begin: from above the wheels hold and the cost is smooth
_GRIPS = (1.0, 1.4)
_PART, _LEAST = 0.35, 85.0  # share of the driving a rough fit sees, and at least so many seconds
SENSOR_BIASES = {
  "accel_bias_x": 0.15,  # m/s^2
  "accel_bias_y": 0.15,
  "gyro_bias": 0.02,  # rad/s
  "encoder_latency": 0.003,  # s
}
_GYRO_WANDERS = 0.002  # rad/s, between rest and drive: warmth and shaking
BIAS_MECHANISMS = ("accel_bias", "gyro_bias", "encoder_latency")
# small errors of what is measured with a ruler, read in a data sheet or drawn as a simple linkage
TOLERATED_MECHANISMS = (
  "wheel_radius_error",
  "imu_lever_arm",
  "steering_nonlinearity",
  "steering_gain_error",
  "pose_mount",
  "load_transfer",
)
TOLERANCES = {
  "accel_scale_x": 0.015,  # data sheets allow 1 to 3 %
  "accel_scale_y": 0.015,
  "steering_nonlinearity": 0.015,  # at lock: Ackermann's geometry and a parabola for it differ by 1.5 % at 0.4 rad
  "steering_gain_error": 0.007,  # 0.2 degrees at 30, as a protractor reads it
  "pose_mount_x": 0.0035,  # m, a marker's place
  "pose_mount_y": 0.0035,
  "pose_mount_yaw": 0.004,  # rad
  "load_sensitivity": 0.07,  # of the cornering stiffness' exponent, which nobody measures on such tyres
}
_WIDEST = 3.0  # standard deviations that recalibration may use up; beyond them is a mechanism


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
  progress: Callable[[str], None] = lambda text: None,
) -> Baseline:
  """Fit the base parameters to recordings.

  Args:
    twin: the car with the whole catalogue, all at null.
    recordings: those of role "validate" are not fitted; they only judge.
    priors: base parameters with better first guesses than the vehicle's nominal ones.
    shifts: command timings to try, control periods; more than one where the log's convention is unknown.
    cut: how recordings are cut.
    progress: told what is being done.
  """
  recordings = sorted(recordings, key=lambda r: r.role == "validate")
  passport = noise_passport(recordings)
  base, floor = priors or twin.base, sensor_floor(passport)
  driven = sum(r.duration for r in recordings)
  part = dataclasses.replace(cut, most=max(_LEAST, _PART * min(driven, cut.most)))
  attempts = []
  for shift in shifts:
    progress(f"recalibration, commands shifted by {shift}" if len(shifts) > 1 else "recalibration")
    attempts.append(_approach(twin, recordings, base, floor, dataclasses.replace(part, shift=shift)))
  raw = np.array([np.sum(np.abs(attempts[0][0].whiten(a[1]))[: attempts[0][0].fitted]) for a in attempts])
  start, shift = attempts[int(np.argmin(raw))][2], shifts[int(np.argmin(raw))]
  observations = observe(recordings, twin.vehicle, dataclasses.replace(cut, shift=shift))
  problem = _weighted(twin, observations, fitted_count(observations, recordings), base, start, floor)
  return _settled(problem, passport, base, start, shift)


def recalibrate_from(baseline: Baseline, theta: Array) -> Baseline:
  """The recalibrated twin fitted again from estimates of all parameters, (P,), weighted by the residuals there."""
  old, base = baseline.problem, baseline.fit.parameters
  start = theta[[old.parameters.index(name) for name in base.names]]
  problem = _weighted(old.twin, old.observations, old.fitted, base, start, sensor_floor(baseline.passport))
  return _settled(problem, baseline.passport, base, start, baseline.shift)


def _settled(
  problem: Problem, passport: Mapping[str, ChannelNoise], base: ParameterSet, start: Array, shift: int
) -> Baseline:
  """The minimum near a start: every model of a search is measured against it, so it is sought to a nat."""
  found = _fit(problem, base, start, 12, 0.0)
  around = problem.parameters.nominal
  everything = lambda v: problem.residual(problem.embed(base.names, v, around))
  whole = finite_differences(everything, base, found.theta, everything(found.theta[None])[0])
  theta = problem.embed(base.names, found.theta, around)[0]
  return Baseline(problem, passport, found, theta, whole, shift)


def _approach(
  twin: Twin, recordings: Sequence[Recording], base: ParameterSet, floor: Mapping[str, float], cut: Cut
) -> tuple[Problem, Array, Array]:
  """A rough fit on part of the driving: the problem, predicted minus measured, and the estimates."""
  observations = observe(recordings, twin.vehicle, cut)
  fitted = fitted_count(observations, recordings)
  start, held = _best_start(twin, observations, fitted, base), _held(base)
  problem = _weighted(twin, observations, fitted, base, start, floor)
  attempts = [_fit(problem, held, _with_grip(base, start, grip), 5, 1e-2) for grip in _GRIPS]
  found = min(attempts, key=lambda f: f.cost)
  problem = _weighted(twin, observations, fitted, base, found.theta, floor)
  found = _fit(problem, base, found.theta, 4, 5e-3)
  return problem, problem.raw(problem.embed(base.names, found.theta, twin.parameters.nominal))[0], found.theta


def _held(base: ParameterSet) -> ParameterSet:
  """The same with what was weighed and measured held ten times closer.

  A wheel that slides hard in the wrong twin makes the cost so rough that a fit of everything ends where a false
  centre of gravity makes up for a false grip, thousands of nats above the minimum.
  """
  measured = [base[n] for n in _BODY if base[n].std]
  return base.replace(**{p.name: dataclasses.replace(p, std=0.1 * (p.std or 0.0)) for p in measured})


def _with_grip(base: ParameterSet, theta: Array, grip: float) -> Array:
  """The estimates with a share of the nominal friction coefficient."""
  out, i = theta.copy(), base.index("friction_coefficient")
  out[i] = np.clip(grip * base.nominal[i], base.lower[i], base.upper[i])
  return out


def _fit(problem: Problem, base: ParameterSet, start: Array, iterations: int, tolerance: float) -> Fit:
  around = problem.parameters.nominal
  residual = lambda v: problem.fitted_residual(problem.embed(base.names, v, around))
  told = lambda i, cost: log.info("iteration %d: cost %.1f", i, cost)
  return fit(residual, base, start, iterations=iterations, tolerance=tolerance, robust=np.inf, progress=told)


def _weighted(
  twin: Twin, observations: Observations, fitted: int, base: ParameterSet, theta: Array, floor: Mapping[str, float]
) -> Problem:
  """The problem with weights from the residuals at theta."""
  problem = Problem(twin, observations, _flat_weighting(observations), fitted, base.names)
  raw = problem.raw(problem.embed(base.names, theta, twin.parameters.nominal))[0]
  return problem.reweighted(weighting_from(observations, raw, floor))


def fitted_count(observations: Observations, recordings: Sequence[Recording]) -> int:
  """How many values, from the front, belong to recordings that are fitted."""
  judging = [i for i, r in enumerate(recordings) if r.role == "validate"]
  if len(judging) == len(recordings):
    raise ValueError('no recording has the role "identify"; give at least one that role in dataset.toml')
  return int(np.sum(~np.isin(observations.recording, judging)))


def with_sensor_biases(base: ParameterSet, twin: Twin, recordings: Sequence[Recording]) -> ParameterSet:
  """The base parameters and the small errors every IMU and encoder has, so that they are not taken for physics.

  One far beyond them is claimed as such; see decide. A gyro's is read where the car stands: it does not turn there,
  whatever else is wrong with the twin. An accelerometer's is not: there it reads the floor's slope as well.
  """
  biases = [dataclasses.replace(twin.parameters[n], std=s) for n, s in SENSOR_BIASES.items() if n in twin.parameters]
  return base + [_read_at_rest(p, recordings) if p.name == "gyro_bias" else p for p in biases]


def _read_at_rest(gyro: Parameter, recordings: Sequence[Recording]) -> Parameter:
  """The gyro's bias with what it read at rest as its prior, in standard deviations of what it wanders."""
  means = means_at_rest(recordings, "yaw_rate")
  if not len(means):
    return gyro
  scatter = float(np.std(means, ddof=1)) if len(means) > 1 else 0.0
  nominal = float(np.clip(np.mean(means), gyro.lower, gyro.upper))
  return dataclasses.replace(
    gyro, nominal=nominal, std=min(float(np.hypot(_GYRO_WANDERS, scatter)), gyro.std or np.inf)
  )


def with_tolerances(priors: ParameterSet, twin: Twin) -> ParameterSet:
  """The same and the errors that are allowed for, within three standard deviations, lest they be taken for physics.

  A wheel radius that is 0.9 % off makes every turn 0.9 % too wide: without this it was claimed as an error of the
  steering. So were an accelerometer that feels a body roll which the twin's does not have, and a linkage that turns
  the two wheels a little otherwise. No place is added that the vehicle's description states no standard deviation of.
  """
  car = twin.vehicle
  stds = {"wheel_radius_error": car.std.get("wheel_radius", 0.0) / car.wheel_radius}
  stds |= {f"imu_lever_arm_{axis}": car.std.get(f"imu_{axis}", 0.0) for axis in ("x", "y")}
  stds |= TOLERANCES
  known = {n: s for n, s in stds.items() if s > 0.0 and n in twin.parameters and n not in priors}
  return priors + [
    dataclasses.replace(twin.parameters[n], std=s, lower=-_WIDEST * s, upper=_WIDEST * s) for n, s in known.items()
  ]


def sensor_floor(passport: Mapping[str, ChannelNoise], horizon: float = 1.0) -> dict[str, float]:
  """Smallest standard deviation a residual channel can have: the sensor's own noise."""
  floor = {name: noise.std for name, noise in passport.items()}
  if "pose_x" in passport and "pose_y" in passport:
    position = float(np.hypot(passport["pose_x"].std, passport["pose_y"].std))
    floor["pose_forward"] = floor["pose_left"] = position
  if "pose_yaw" in passport:
    floor["pose_turn"] = float(np.sqrt(2.0) * passport["pose_yaw"].std)
  return floor


def _flat_weighting(observations: Observations) -> Weighting:
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
  residual = problem.fitted_residual(problem.embed(base.names, np.stack(guesses), twin.parameters.nominal))
  return guesses[int(np.argmin(np.sum(np.abs(residual), axis=1)))]
