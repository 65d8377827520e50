"""Small errors that every car and sensor has: every model fits them, so that they are not taken for physics.

Which they are and how large is declared by the mechanisms; see `Mechanism.sensor_errors` and `Mechanism.tolerances`.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.likelihood import Problem, Weighting
from calibration.fitting.noise import means_at_rest
from calibration.fitting.observations import CHANNELS, Observations
from calibration.fitting.optimiser import Fit, prior_cost
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.mechanisms.base import AS_GOOD, CarDimensions, Mechanism, SensorError
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.drive import DriveKind
from qcar_twin.vehicle.vehicle import QCAR

Array = NDArray[np.float64]
_TOUCHES = 1e-4  # of a bound, within which an estimate has stopped there
_UNUSUAL = 2.0  # standard deviations: one car in twenty
_EXACT = 1e-9  # share of a sum of squares that is none
_STATED = dict.fromkeys((f.name for f in dataclasses.fields(CarDimensions)), 1.0)  # deviations of whatever is measured
# what a log hardly tells apart: commands that act late, and sensors that all speak late; how far they are exchanged, s
_COMMANDS, _SENSORS = ("drive_delay", "steering_delay"), ("encoder_latency", "imu_latency", "pose_latency")
_STEP, _MOST = 1e-3, 0.1
_WIDEST = 3.0  # standard deviations that recalibration may use up; beyond them is a mechanism


def sensor_error_mechanisms(mechanisms: Iterable[Mechanism]) -> tuple[Mechanism, ...]:
  """Those with an error every sensor of the kind has, in the order in which every model fits them."""
  return tuple(m for m in _ranked(mechanisms) if m.sensor_errors)


def tolerated_mechanisms(mechanisms: Iterable[Mechanism]) -> tuple[Mechanism, ...]:
  """Those with an error any description of a car leaves open, in the order in which every model fits them."""
  return tuple(m for m in _ranked(mechanisms) if type(m).tolerances is not Mechanism.tolerances)


def always_fitted(drive: DriveKind) -> tuple[str, ...]:
  """Ids of all of these in the catalogue that a drive can have: what a twin carries that is fitted to recordings."""
  known = [m for m in catalogue().values() if drive in m.drives]
  car = CarDimensions.of(dataclasses.replace(QCAR, drive=drive))
  some = [m for m in tolerated_mechanisms(known) if any(m.tolerances(car, _STATED).values())]
  return tuple(dict.fromkeys(m.name for m in (*sensor_error_mechanisms(known), *some)))


def with_sensor_biases(base: ParameterSet, twin: Twin, recordings: Sequence[Recording]) -> ParameterSet:
  """The base parameters and the small errors that the sensors of the twin have, each with its usual size as a prior.

  One far beyond them is claimed as such; see bias_claims. One that shows where the car stands is read there.
  """
  logs = [lambda name, r=r: r[name].time if name in r else None for r in recordings]
  return base + [
    _read_at_rest(
      dataclasses.replace(twin.parameters[name], std=_usual(error, m, logs), assumed=True), error, recordings
    )
    for m in sensor_error_mechanisms(twin.mechanisms)
    for name, error in m.sensor_errors.items()
  ]


def usual_errors(mechanisms: Iterable[Mechanism], observations: Observations | None = None) -> dict[str, float]:
  """What is usual of the sensors' errors, standard deviations by parameter, where so often was sampled."""
  known = sensor_error_mechanisms(mechanisms)
  if observations is None:
    return {name: error.std for m in known for name, error in m.sensor_errors.items()}
  times = lambda name: observations.time[observations.select(name)] if name in observations.present else None
  return {name: _usual(e, m, [times]) for m in known for name, e in m.sensor_errors.items()}


def _usual(error: SensorError, mechanism: Mechanism, logs: Sequence[Callable[[str], Array | None]]) -> float:
  """Standard deviation by the channel it is logged as and the median time between two of its samples; each log has the
  times of a channel by name."""
  if not error.per_period and not error.as_logged:
    return error.std
  names = [name for needed in (*mechanism.needs, "speed") for name in AS_GOOD.get(needed, (needed,))]
  clocks = [next(((n, t) for n in names if (t := times(n)) is not None), ("", np.zeros(0))) for times in logs]
  steps = np.concatenate([np.zeros(0), *(np.diff(clock) for _, clock in clocks)])
  steps = steps[steps > 0.0]  # stretches of one recording lie one after the other
  more = max((error.as_logged.get(name, 0.0) for name, _ in clocks), default=0.0)
  return float(np.hypot(np.hypot(error.std, more), error.per_period * (np.median(steps) if len(steps) else 0.0)))


def _read_at_rest(parameter: Parameter, error: SensorError, recordings: Sequence[Recording]) -> Parameter:
  """The parameter with what was read at rest as its prior, in standard deviations of what it wanders."""
  means = means_at_rest(recordings, error.read_at_rest) if error.read_at_rest else np.zeros(0)
  if not len(means):
    return parameter
  scatter = float(np.std(means, ddof=1)) if len(means) > 1 else 0.0
  nominal = float(np.clip(np.mean(means), parameter.lower, parameter.upper))
  return dataclasses.replace(parameter, nominal=nominal, std=min(float(np.hypot(error.wander, scatter)), error.std))


def with_tolerances(priors: ParameterSet, twin: Twin, recordings: Sequence[Recording] = ()) -> ParameterSet:
  """The same and the errors that are allowed for, within three standard deviations, not to be taken for physics.

  A wheel radius that is 1 % off makes every turn 1 % too wide and would pass for an error of the steering; so would a
  linkage that turns the two wheels a little otherwise, and a body roll that the twin's accelerometer does not feel for
  a tilted sensor. What a channel errs in is none where another stands in its place.
  """
  stds = {}
  for mechanism in tolerated_mechanisms(m for m in twin.mechanisms if not without_channel(m, recordings)):
    stds |= mechanism.tolerances(twin.car, twin.vehicle.std)
  known = {name: std for name, std in stds.items() if std > 0.0 and name not in priors}
  return priors + [_tolerated(twin.parameters[name], std) for name, std in known.items()]


def without_channel(mechanism: Mechanism, recordings: Sequence[Recording]) -> bool:
  """Whether no sensor logged what a mechanism errs in, since another channel stands in its place, or what shows it."""
  logged = {name for r in recordings for name in r.channels if name not in r.derived}
  instead = {*mechanism.replaced_by}
  return bool(instead) and (bool(logged & instead) or not {*mechanism.needs} <= logged)


def _tolerated(parameter: Parameter, std: float) -> Parameter:
  """The parameter within three standard deviations, to one side where it has one sign only."""
  lower, upper = max(parameter.lower, -_WIDEST * std), min(parameter.upper, _WIDEST * std)
  return dataclasses.replace(parameter, std=std, lower=lower, upper=upper, assumed=True)


def widened(parameters: ParameterSet, estimates: NDArray[np.float64]) -> ParameterSet:
  """The same with the bound twice as far at which an estimate, (p,), of an open or a class figure stopped.

  Such a bound says where a search is unlikely to end, and is no knowledge of the car.
  """
  moved = {}
  for p, value in zip(parameters, estimates, strict=True):
    if p.kind == "measured" or p.assumed or p.null is not None or p.lower <= 0.0:
      continue
    if value >= p.upper * (1.0 - _TOUCHES):
      moved[p.name] = dataclasses.replace(p, upper=2.0 * p.upper)
    elif value <= p.lower * (1.0 + _TOUCHES):
      moved[p.name] = dataclasses.replace(p, lower=0.5 * p.lower)
  return parameters.replace(**moved)


def exchanged(parameters: ParameterSet, theta: Array, worth: float) -> Array | None:
  """Estimates in which dead times of all commands have grown by what ages of all sensors have shrunk, or the other way
  round, (p,), so that the priors find them as likely as can be; None where that gains them less than `worth`, nats.

  Both move what sensors show of a drive by the same time. A fit goes from one to the other along a valley, which held
  commands make rough: it may come to rest anywhere on the way.
  """
  change = np.zeros(len(theta))
  for names, sign in ((_COMMANDS, 1.0), (_SENSORS, -1.0)):
    for name in names:
      if name in parameters.names:
        change[parameters.index(name)] = sign
  if not all(name in parameters.names for name in _COMMANDS) or not (change < 0.0).any():
    return None
  tried = theta + np.arange(-_MOST, _MOST + _STEP, _STEP)[:, None] * change
  inside = ((tried >= parameters.lower) & (tried <= parameters.upper) | (change == 0.0)).all(axis=1)
  costs = np.array([prior_cost(one, parameters) for one in tried[inside]])
  if not len(costs) or prior_cost(theta, parameters) - costs.min() < worth:
    return None
  return tried[inside][int(np.argmin(costs))]


def weighed_beyond(problem: Problem, fit: Fit, jacobian: Array, floor: Mapping[str, float]) -> tuple[Weighting, float]:
  """Weights of every channel from what it leaves where the tolerance that explains most of it goes on, and what that is
  worth by them, nats.

  What goes on beyond a tolerance is physics, and no noise of a channel. A wheel whose radius is 6 % off is allowed
  3.6 %; all of the rest is left in the displacement forward, many times what its sensor makes. Weighed by that, the
  displacement tells next to nothing of the radius, and nobody asks what it is.

  Args:
    problem: residuals with the weights of the fit.
    fit: the base parameters', p of them.
    jacobian: d whitened residual / d base parameters, (M, p).
    floor: standard deviation of each channel that its sensor makes, by name: no weight is of less.

  Each channel has its own amount, by a straight line, outward only: r_c + J_c a with the a >= 0 that leaves least.
  """
  outward = _outward(problem, fit)
  channel, std, worth = problem.observations.channel[: problem.n_train], problem.weighting.std.copy(), 0.0
  for index in np.unique(channel):
    rows = channel == index
    residual, slopes = fit.residual[rows], jacobian[: problem.n_train][rows] * outward
    power, pull = np.sum(slopes**2, axis=0), np.maximum(-(residual @ slopes), 0.0)
    taken = np.max(np.divide(pull**2, power, out=np.zeros_like(power), where=power > 0.0), initial=0.0)
    if taken == 0.0:
      continue
    least = floor.get(CHANNELS[index], 0.0) / std[index]
    left = max(1.0 - taken / float(residual @ residual), least**2, _EXACT)
    std[index] *= min(np.sqrt(left), 1.0)
    worth += 0.5 * taken / left
  return dataclasses.replace(problem.weighting, std=std), worth


def _outward(problem: Problem, fit: Fit) -> Array:
  """Sign of the way beyond the bound at which a tolerance stopped, (p,); 0 for all other parameters."""
  out = np.zeros(len(fit.theta))
  for i, (p, value) in enumerate(zip(fit.parameters, fit.theta, strict=True)):
    if fit.at_bound[i] and p.assumed and p.null is not None:
      declared, low = problem.parameters[p.name], value - p.lower < p.upper - value
      out[i] = -float(declared.lower < p.lower) if low else float(declared.upper > p.upper)
  return out


def stopped(parameters: ParameterSet, estimates: NDArray[np.float64], at_bound: NDArray[np.bool_]) -> str:
  """A sentence about estimates, (p,), that stopped at a bound, (p,); empty if none did: a share may be 0 or 1."""
  said = [
    f"{p.name} = {value:.3g} {p.unit} ({p.prior})"
    for p, value, at in zip(parameters, estimates, at_bound, strict=True)
    if at and abs(value) > _TOUCHES * (p.upper - p.lower) and (p.lower, p.upper) != (0.0, 1.0)
  ]
  if not said:
    return ""
  return f"at the bound of what recalibration allows for: {', '.join(said)}; the twin may lack what these make up for"


def rather(parameters: ParameterSet, estimates: NDArray[np.float64]) -> str:
  """A sentence about shares that may be anything, all within three deviations, and are nearer to all than to none, (p,)
  estimates; empty where none is. Such a share is no missing physics, but who takes the twin for another car's wants to
  know.
  """
  said = [
    f"{p.description} ({p.name} = {value:.2g} of 1)"
    for p, value in zip(parameters, estimates, strict=True)
    if p.null == 0.0 and p.upper == 1.0 == _WIDEST * (p.std or 0.0) and value > 0.5
  ]
  return f"which of two kinds this car is, the recordings tell: {', '.join(said)}" if said else ""


def unlike_the_class(parameters: ParameterSet, estimates: NDArray[np.float64]) -> tuple[tuple[Parameter, float], ...]:
  """Class figures whose estimates, (p,), lie beyond two deviations of their priors, with the estimate, farthest first.

  A slow servo or a soft tyre is no missing physics, since every car has a servo and tyres; but who takes the twin for a
  usual car wants to know.
  """
  away = parameters.deviations(estimates)
  far = [i for i, p in enumerate(parameters) if p.kind == "class" and p.null is None and abs(away[i]) > _UNUSUAL]
  figures = tuple(parameters)
  return tuple((figures[i], float(estimates[i])) for i in sorted(far, key=lambda i: -abs(away[i])))


def unusual(parameters: ParameterSet, estimates: NDArray[np.float64]) -> str:
  """A sentence about what is `unlike_the_class`; empty if nothing is."""
  said = [
    f"{p.name} = {value:.3g} {p.unit} (usual are {p.nominal:.3g} {p.unit}, {p.prior})"
    for p, value in unlike_the_class(parameters, estimates)
  ]
  return f"unlike other cars of the class: {', '.join(said)}" if said else ""


def _ranked(mechanisms: Iterable[Mechanism]) -> list[Mechanism]:
  return sorted(mechanisms, key=lambda m: (m.fitted_rank, m.name))
