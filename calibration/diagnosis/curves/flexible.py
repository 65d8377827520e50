"""A twin whose maps are free curves, fitted to a data set.

The twin's own laws of drive and steering are one form each. Where a car's maps are others, no single named effect
helps, and recalibration bends tyres and inertia to make up for it. Here the maps are the base car's laws plus piecewise
linear departures that a prior draws towards zero, together with the lags, the delays, the ages and scales of sensors
that would otherwise bend them, and with a trim and a drive gain for each session. At the curves' null it is today's
twin, bit for bit.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.curves.leads import PERIOD, command_lead
from calibration.fitting.dataset_recalibration import LONGEST, command_shifts, starting_priors
from calibration.fitting.recalibration import RecalibratedTwin, begun, begun_nearer, settled
from calibration.fitting.tolerances import always_fitted
from calibration.fitting.windows import Cut
from calibration.log_check.ready import clock, told_without_a_model
from calibration.progress import Progress, silent
from qcar_twin.kinematics import road_speed
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.engines.reduced.cars import irreducible
from qcar_twin.twin.mechanisms import curves, offered, select
from qcar_twin.twin.mechanisms.base import AS_GOOD, Mechanism
from qcar_twin.twin.sessions import ONE_SESSION, SessionShifts
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

# What would bend the curves if it were left out: actuators in time, sensors in time and scale, the loss of turning.
BESIDE = (
  "steering_offset", "steering_lag", "steering_delay", "drive_lag", "drive_delay", "encoder_latency", "imu_latency",
  "pose_latency", "gyro_scale", "wheel_radius_error", "steering_drag",
)  # fmt: skip
DELAYS, AGES = ("steering_delay", "drive_delay"), ("encoder_latency", "imu_latency", "pose_latency")
_LAGS = {"steering_delay": ("steering_lag", "servo_time_constant"), "drive_delay": ("drive_lag",)}
TRIM, GAIN = 0.02, 0.1  # rad, and share: how far a servo's trim and a pack's voltage usually wander between sessions
_TOP = 0.995  # quantile of the speed that counts as the highest: the rest is spikes


@dataclasses.dataclass(frozen=True)
class Characterised:
  """A twin with curves, fitted.

  Attributes:
    fitted: the twin, with what every model fits, curves and what stands beside them.
    curves: ids of the curves in it; beside: ids of what stands beside them.
    clock: the age that counts as zero.
    forms: ids of named forms in a curve's place.
  """

  fitted: RecalibratedTwin
  curves: tuple[str, ...]
  beside: tuple[str, ...]
  clock: str = "pose_latency"
  forms: tuple[str, ...] = ()

  @property
  def twin(self) -> Twin:
    """The car in MuJoCo, by which it is judged and shipped."""
    return self.fitted.problem.exact.twin.on("mujoco")

  @property
  def theta(self) -> Array:
    return self.fitted.theta

  @property
  def lead(self) -> float:
    """By how much commands act before they are logged, s; delays are counted from there."""
    return -PERIOD * min(self.fitted.command_shift, 0)

  @property
  def unshifted(self) -> Array:
    """Estimates for commands as they are given, (P,): delays less the lead, none below zero; sessions' shifts are
    departures from their mean, so that without them it is the mean car.

    What a delay lacks to the lead is taken off what lags in its place: a lag is the delay of slow changes, too.
    """
    parameters = self.twin.parameters
    theta = self.twin.sessions.mean_car(self.theta, parameters)
    for name in set(DELAYS) & set(self.beside):
      at = parameters.index(name)
      lacking = max(self.lead - theta[at], 0.0)
      theta[at] = max(theta[at] - self.lead, 0.0)
      for lag in (parameters.index(n) for n in _LAGS[name] if n in parameters):
        taken = min(lacking, max(theta[lag] - parameters.lower[lag], 0.0))
        theta[lag] -= taken
        lacking -= taken
    return theta

  @property
  def covariance(self) -> Array:
    """Of the fitted parameters, (p, p): the sandwich H^-1 (sum_s g_s g_s') H^-1 over stretches s of driving.

    A model that is not the car leaves residuals that hang together over seconds; the curvature H counts them as if each
    tenth of a second were a new witness. (White, Maximum likelihood estimation of misspecified models, Econometrica
    50(1), 1982; clusters: Liang and Zeger, Biometrika 73(1), 1986.)
    """
    return self._sandwich(~self.fitted.fit.at_bound, *self._sums())

  @property
  def deviations(self) -> Array:
    """Of the fitted parameters, (p,); of one that stopped at its bound that which it would have without it."""
    held, sums = self.fitted.fit.at_bound, self._sums()
    variance = np.diag(self._sandwich(~held, *sums)).copy()
    for k in np.flatnonzero(held):
      variance[k] = self._sandwich(~held | (np.arange(len(held)) == k), *sums)[k, k]
    return np.sqrt(np.maximum(variance, 0.0))

  def _sums(self) -> tuple[Array, Array]:
    """Curvature and sum of squared scores of stretches, priors included, in units of the parameters' scales, (p, p)."""
    problem, found = self.fitted.problem, self.fitted.fit
    n, scale = problem.n_train, found.parameters.scale
    slopes, residual = self.fitted.jacobian[:n] * scale, problem.fitted_residual(self.theta[None])[0]
    prior = np.diag((scale * found.parameters.deviation_slopes(found.theta)) ** 2)
    stretch = problem.observations.stretch[:n]
    scores = np.zeros((stretch.max() + 1, len(scale)))
    np.add.at(scores, stretch, slopes * residual[:, None])
    return slopes.T @ slopes + prior, scores.T @ scores + prior

  def _sandwich(self, free: NDArray[np.bool_], curvature: Array, scores: Array) -> Array:
    """Covariance where some parameters are free, (p, p); the others have their prior variance."""
    parameters, at = self.fitted.fit.parameters, np.ix_(free, free)
    inverse = np.linalg.pinv(curvature[at], hermitian=True)
    out = np.diag(parameters.std**2)
    out[at] = inverse @ scores[at] @ inverse * np.outer(parameters.scale[free], parameters.scale[free])
    return out


def characterise(
  dataset: DataSet,
  known: Sequence[str] | None = None,
  most: float = LONGEST,
  threads: int = 0,
  progress: Progress = silent,
  plant: EngineKind = "reduced",
  reach: Mapping[str, float] | None = None,
) -> Characterised:
  """Fit a twin with curves to a data set; its role "holdout" stays closed.

  Args:
    dataset: checked, see `ready`.
    known: ids of the mechanisms that are there: they are fitted instead of curves and of what stands beside them, which
      is what somebody could do who knew the car.
    most: s of driving that are simulated, spread evenly.
    threads: of the simulation, 0 for all cores.
    progress: reports the stage.
    plant: what is fitted on: the reduced car, or "mujoco", many times as long.
    reach: where the curves' last knots lie, see `reaches`, which reads it off the recordings.
  """
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  recordings = [r for r in dataset.recordings if r.role != "holdout"]
  shown = {m.name for m in (*offered(vehicle.drive), *curves(vehicle.drive)) if seen_by(m, recordings)}
  shapes = tuple(m.name for m in curves(vehicle.drive) if known is None and m.name in shown)
  wanted = [name for name in BESIDE if name != clock(recordings)] if known is None else known
  beside = tuple(name for name in wanted if name in shown)
  trim = ("steering_offset",) if "steering_offset" in shown else ()  # what a session's own trim is counted from
  names = tuple(dict.fromkeys((*shapes, *beside, *trim)))
  shifts = session_shifts(dataset, vehicle) if "steering_offset" in names else ONE_SESSION
  carried = select(dict.fromkeys([*names, *always_fitted(vehicle.drive)]))
  twin = Twin(vehicle, carried, threads=threads, sessions=shifts)
  searched = fitted_on(twin, plant)
  priors = flexible_priors(recordings, searched, names, reach or reaches(recordings, vehicle))
  lead = command_lead(recordings)
  shifts = (-lead,) if lead else command_shifts(dataset)
  # evenly: what is chosen for what it tells is what the car does at its limits, which bends a twin that lacks physics
  at = begun_nearer(begun(searched, recordings, priors, shifts, Cut(most=most, evenly=True), progress))
  fitted = settled(at.problem, at.noise_models, priors, at.start, at.command_shift)
  return Characterised(fitted, shapes, beside, clock(recordings))


def fitted_on(twin: Twin, plant: EngineKind) -> Twin:
  """What a free base is fitted on: the reduced car as it is, where it can stand in.

  A correction by MuJoCo at one place, as recalibration has it, is worth little to a fit that moves as far as this one.
  """
  return twin if plant == "mujoco" or irreducible(twin.vehicle, twin.tyre) else twin.on("reduced")


def seen_by(mechanism: Mechanism, recordings: Sequence[Recording]) -> bool:
  """Whether the recordings hold every channel a mechanism needs, or one that is as good."""
  present = {name for r in recordings for name in r.channels}
  return all(present & {*AS_GOOD.get(name, (name,))} for name in mechanism.needs)


def session_shifts(dataset: DataSet, vehicle: Vehicle) -> SessionShifts:
  """A trim and a drive gain for each session that is fitted, where there are more than one."""
  session_of = {r.name: r.session for r in dataset.recordings if r.role != "holdout" and r.session}
  if len(set(session_of.values())) < 2:
    return ONE_SESSION
  every = {r.name: r.session for r in dataset.recordings if r.session in set(session_of.values())}
  return SessionShifts(every, {"steering_offset": TRIM, vehicle.motor.gain: GAIN * vehicle.torque_per_command})


def reaches(recordings: Sequence[Recording], vehicle: Vehicle) -> dict[str, float]:
  """Where the curves' last knots lie: the largest commands [V, rad] and the highest speed [m/s] driven."""
  command = max(float(np.max(np.abs(r[r.drive_channel].value))) for r in recordings) * vehicle.command_scale
  steered = [float(np.max(np.abs(r["steering_command"].value))) for r in recordings if "steering_command" in r]
  speeds = [np.zeros(1)]
  for recording in recordings:
    if "motor_speed" in recording:
      speeds.append(np.abs(road_speed(recording["motor_speed"].value, vehicle)))
    elif "speed" in recording:
      speeds.append(np.abs(recording["speed"].value))
  speed = float(np.quantile(np.concatenate(speeds), _TOP))
  return {
    "drive_curve_reach": max(command, 0.1),
    "resistance_curve_reach": max(speed, 0.1),
    "steering_curve_reach": min(max([0.02, *steered]), vehicle.max_steering),
  }


def flexible_priors(
  recordings: Sequence[Recording], twin: Twin, names: Sequence[str], reach: Mapping[str, float]
) -> ParameterSet:
  """What is fitted: all that recalibration fits, and the parameters of the mechanisms named, with wide priors."""
  mechanisms = {m.name: m for m in twin.mechanisms}
  added = [opened(p) for name in names for p in mechanisms[name].parameters]
  placed = [
    dataclasses.replace(p, nominal=reach[p.name], std=1e-3 * reach[p.name]) if p.name in reach else p for p in added
  ]
  taken = {p.name for p in placed}
  base = [p for p in starting_priors(recordings, twin, None) if p.name not in taken]
  timed = _timed(placed, recordings, twin.vehicle)
  return ParameterSet([*base, *timed, *twin.sessions.parameters(twin.parameters)])


def _timed(placed: Sequence[Parameter], recordings: Sequence[Recording], vehicle: Vehicle) -> list[Parameter]:
  """The same with what is known of ages: sensors' from geometry, delays counted from commands that were moved."""
  told = told_without_a_model(recordings, vehicle)
  late = PERIOD * command_lead(recordings)
  known = {name: (float(value), std) for name, (value, std) in told.items()}
  known |= {name: (late, 0.5 * late + 0.04) for name in DELAYS if late}
  return [
    dataclasses.replace(p, nominal=float(np.clip(known[p.name][0], p.lower, p.upper)), std=known[p.name][1])
    if p.name in known
    else p
    for p in placed
  ]


def opened(parameter: Parameter) -> Parameter:
  """Known to twice its typical size, where nothing better is stated."""
  if parameter.factor:
    return parameter
  wide = 2.0 * (parameter.typical or 0.3 * abs(parameter.nominal) or 1.0)
  return dataclasses.replace(parameter, std=parameter.std or wide)
