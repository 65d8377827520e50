"""Cornering stiffness of both axles from step steers: the paper's two-stage least squares, and an exact one.

Steady state "paper", as printed: steady lateral accelerations give k_su = delta / a_ys by least squares through
the origin, and C_r = (k_su C_f L_f v^2 - C_f L_f^2) / L_r^2, which leaves sideslip out of the yaw equation.
"exact": steady yaw rates give the understeer gradient K of delta = (L + K v^2) r / v, and C_r follows from C_f
and K. Yaw rate rather than lateral acceleration, because an IMU on a rolling body also feels g sin(roll), 2 %
here, which passes for understeer. The car steers less at large angles (coupled axles scrub, tyres bend), as the
square of the angle; K is the value at zero angle, where the linear model is meant, and what the square takes is
kept apart from it (`TurningLosses`).

Transient "linear", as printed: C_f minimises the time-averaged squared error of the bicycle's lateral
acceleration, filtered in the same way. "lagged": servo, transient slip and saturation are fitted with it (`transient`);
without them C_f misses the stiffness the tyres have at small slip by up to a half.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from calibration.identification import transient_single_track as transient
from calibration.identification.drive_fit import NotIdentifiable, StepError, jackknife_covariance
from calibration.identification.steering_steps import (
  LinearResponses,
  SteadyTurns,
  Turn,
  cut,
  find_turns,
  fit_steady_turns,
)
from calibration.identification.step_detection import moving_average
from qcar_twin import kinematics
from qcar_twin.bicycle.bicycle import MeasuredCar, drive_of, parameters_of
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.similarity import Similarity

Array = NDArray[np.float64]

TRANSIENT = 0.5  # s, duration of the transient in the printed cost
MEASURED = ("mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "imu_x")
UNMOVED = ("imu_y", "wheel_radius", "gear_ratio", "max_steering")
UNSTATED = {"mass": 0.01, "yaw_inertia": 0.10, "cg_to_front": 0.02, "cg_to_rear": 0.02, "wheel_radius": 0.01}
UNSTATED_IMU = 0.003  # m; the others relative
LINEAR_NOTE = (
  "linear transient: stiffness that a linear car without servo or tyre lag needs; its deviations hold scatter and"
  " measured numbers, not that bias"
)


@dataclasses.dataclass(frozen=True)
class LateralFit:
  """C_f, C_r [N/rad] with covariance (2, 2), and what they rest on.

  Attributes:
    understeer_gradient: K of the exact steady state, rad s^2/m, and its standard deviation.
    steering_loss: of `TurningLosses`, 1/rad^2, and its standard deviation; NaN if not fitted.
    steering_per_accel: k_su = delta / a_ys at `speed`, rad s^2/m: fitted as printed, or the exact one.
    printed_error_percent: printed k_su over exact k_su of these stiffnesses, minus one, per cent.
    nuisances: what else the transient fit settled on, by name.
    steps: error of lateral acceleration on every step.  yaw_rate_steps: of yaw rate.
  """

  values: tuple[float, float]
  covariance: tuple[tuple[float, ...], ...]
  speed: float
  understeer_gradient: float
  understeer_gradient_std: float
  steering_loss: float
  steering_loss_std: float
  steering_per_accel: float
  printed_error_percent: float
  nuisances: dict[str, float]
  steps: tuple[StepError, ...]
  yaw_rate_steps: tuple[StepError, ...]
  notes: tuple[str, ...]


def fit_lateral(
  recordings: Sequence[Recording], vehicle: MeasuredCar, std: Mapping[str, float], steady_state: str, transient: str
) -> LateralFit:
  """C_f and C_r from the step steers with role "identify"; errors on all steps given.

  Args:
    vehicle: measured numbers.  std: their standard deviations by name; what is missing is taken as
      1 % of mass and wheel radius, 10 % of yaw inertia, 2 % of the semi-wheelbases, 3 mm of the IMU's place.
    steady_state: "exact" or "paper".  transient: "lagged" or "linear"; "lagged" goes with "exact" only.

  Raises:
    NotIdentifiable: no two step steers with a lateral channel.
  """
  turns = find_turns(recordings, vehicle)
  used = [t for t in turns if t.step.role == "identify" and t.step.steady is not None]
  if len({round(abs(t.step.level), 3) for t in used}) < 2:
    raise NotIdentifiable(
      f"the tyres need step steers of two angles or more with yaw_rate or accel_y; {len(used)} steering_step"
      " recordings with role 'identify' have a step that settles. Record steering_step runs at about 1.5 m/s"
    )
  spread = {name: std.get(name, share * getattr(vehicle, name)) for name, share in UNSTATED.items()}
  spread["imu_x"] = std.get("imu_x", UNSTATED_IMU)
  if transient == "lagged":
    return _lagged(turns, used, vehicle, spread)
  return _linear(turns, used, vehicle, spread, steady_state)


# -- linear transient ----------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Constraint:
  """What the steady turns leave of the tyres: C_r as a function of C_f."""

  steady: SteadyTurns
  speed: float
  printed: float | None  # k_su [rad s^2/m] as printed; None for the exact steady state

  def stiffness(self, front: float, vehicle: MeasuredCar) -> Array:
    """(C_f, C_r) [N/rad]; C_r is kept positive."""
    lengths = vehicle.cg_to_front, vehicle.cg_to_rear
    if self.printed is None:
      return np.array([front, transient.rear_stiffness(front, self.steady.gradient, vehicle.mass, *lengths)])
    ratio = (self.printed * lengths[0] * self.speed**2 - lengths[0] ** 2) / lengths[1] ** 2
    return front * np.array([1.0, max(ratio, 0.05)])


def _linear(
  turns: Sequence[Turn], used: Sequence[Turn], vehicle: MeasuredCar, std: Mapping[str, float], steady_state: str
) -> LateralFit:
  if steady_state == "paper" and not all("accel_y" in t.signals for t in used):
    raise NotIdentifiable("the paper's identification needs accel_y; use steady_state='exact', which takes yaw_rate")
  with_loss = len(used) >= 4
  constraint = _constraint(used, vehicle, std, steady_state, with_loss)
  values = _linear_stage(used, vehicle, constraint)
  logs = []
  for i in range(len(used)):
    others = _others(used, i)
    logs.append(np.log(_linear_stage(others, vehicle, _constraint(others, vehicle, std, steady_state, with_loss))))
  covariance = jackknife_covariance(np.array(logs)) + _measured_covariance(used, vehicle, std, constraint, values)
  steady = constraint.steady
  if steady_state == "paper":
    steady = SteadyTurns(_gradient(values, vehicle), float("nan"))
  return _result(turns, vehicle, values, covariance, constraint.speed, steady, constraint.printed, {}, (LINEAR_NOTE,))


def _constraint(
  used: Sequence[Turn], vehicle: MeasuredCar, std: Mapping[str, float], steady_state: str, with_loss: bool
) -> _Constraint:
  speed = float(np.mean([t.steady("speed") for t in used]))
  if steady_state == "exact":
    return _Constraint(fit_steady_turns(used, vehicle, std, with_loss), speed, None)
  steering = np.array([t.steady("steering") for t in used])
  accel = np.array([t.steady("accel_y") for t in used])
  return _Constraint(SteadyTurns(0.0, 0.0), speed, float(steering @ steering / (steering @ accel)))


def _linear_stage(used: Sequence[Turn], vehicle: MeasuredCar, constraint: _Constraint) -> Array:
  """(C_f, C_r) [N/rad] of the printed transient cost: lateral acceleration, or yaw rate where it is not logged."""
  channel = "accel_y" if all("accel_y" in t.signals for t in used) else "yaw_rate"
  about = [cut(t, TRANSIENT) for t in used]
  transient = LinearResponses(about, vehicle)
  wanted = [moving_average(t.signals[channel]) for t in about]

  def cost(log_front: float) -> float:
    modelled = transient.model(constraint.stiffness(np.exp(log_front), vehicle))[channel]
    pairs = zip(wanted, modelled, about, strict=True)
    return float(sum(np.mean(np.square(w - f)[t.step.first :]) for w, f, t in pairs))

  similarity = Similarity.of(vehicle.cg_to_front + vehicle.cg_to_rear)
  front = parameters_of(drive_of(vehicle), similarity)["cornering_stiffness_front"]
  bounds = np.log([front.lower, front.upper])
  optimum = minimize_scalar(cost, bounds=tuple(bounds), method="bounded", options={"xatol": 1e-5})
  return constraint.stiffness(float(np.exp(optimum.x)), vehicle)


def _measured_covariance(
  used: Sequence[Turn], vehicle: MeasuredCar, std: Mapping[str, float], constraint: _Constraint, values: Array
) -> Array:
  """Covariance of log (C_f, C_r) from the deviations of the measured numbers and of K: one refit each."""
  cases = []
  for name in MEASURED:
    moved = SimpleNamespace(**{k: getattr(vehicle, k) for k in (*MEASURED, *UNMOVED)})
    setattr(moved, name, getattr(moved, name) + std[name])
    cases.append((moved, constraint))
  if constraint.printed is None:
    steady = dataclasses.replace(
      constraint.steady, gradient=constraint.steady.gradient + constraint.steady.gradient_std
    )
    cases.append((vehicle, dataclasses.replace(constraint, steady=steady)))
  shifts = np.array([np.log(_linear_stage(used, car, law) / values) for car, law in cases])
  return shifts.T @ shifts


# -- lagged transient ----------------------------------------------------------------------------


def _lagged(turns: Sequence[Turn], used: Sequence[Turn], vehicle: MeasuredCar, std: Mapping[str, float]) -> LateralFit:
  with_loss = len(used) >= 4
  steady = fit_steady_turns(used, vehicle, std, with_loss)
  numbers = {name: getattr(vehicle, name) for name in MEASURED}
  unknowns = transient.unknowns(numbers, std, steady.gradient, steady.gradient_std)
  fit = transient.fit_transients(_transients(used), unknowns)
  others = [fit_steady_turns(_others(used, i), vehicle, std, with_loss) for i in range(len(used))]
  moved = [other.gradient - steady.gradient for other in others]
  covariance = fit.covariance + jackknife_covariance(fit.without + np.outer(moved, fit.by_gradient))
  speed = float(np.mean([t.steady("speed") for t in used]))
  note = f"transient fit: chi-squared per degree of freedom {fit.chi_squared:.2f}"
  return _result(turns, vehicle, np.array(fit.stiffness), covariance, speed, steady, None, fit.values, (note,))


def _transients(used: Sequence[Turn]) -> transient.Transients:
  first = [t.step.first for t in used]
  rows = [np.clip(np.arange(k - transient.BEFORE, k + transient.AFTER), 0, None) for k in first]
  names = [name for name in ("yaw_rate", "accel_y") if all(name in t.signals for t in used)]

  def cut(values: Sequence[Array]) -> Array:
    return np.stack([v[np.minimum(r, len(v) - 1)] for v, r in zip(values, rows, strict=True)])

  noise = {name: float(np.sqrt(np.mean([_sample_noise(t, name) ** 2 for t in used]))) for name in names}
  return transient.Transients(
    cut([t.step.commands[:, 1] for t in used]),
    cut([t.speed for t in used]),
    {name: cut([t.signals[name] for t in used]) for name in names},
    noise,
  )


def _sample_noise(turn: Turn, name: str) -> float:
  """Standard deviation of samples about their steady mean: sensor noise and disturbances while driving."""
  return float(np.std(turn.signals[name][turn.step.steady]))


# -- both ----------------------------------------------------------------------------------------


def _gradient(values: Array, vehicle: MeasuredCar) -> float:
  return float(kinematics.understeer_gradient(vehicle.mass, vehicle.cg_to_front, vehicle.cg_to_rear, *values))


def _others(used: Sequence[Turn], index: int) -> list[Turn]:
  return [t for k, t in enumerate(used) if k != index]


def _result(
  turns: Sequence[Turn],
  vehicle: MeasuredCar,
  values: Array,
  covariance: Array,
  speed: float,
  steady: SteadyTurns,
  printed_fit: float | None,
  nuisances: Mapping[str, float],
  notes: tuple[str, ...],
) -> LateralFit:
  lengths = vehicle.cg_to_front, vehicle.cg_to_rear
  gradient = _gradient(values, vehicle)
  printed = kinematics.steering_per_lateral_acceleration_as_printed(speed, *lengths, *values)
  exact = kinematics.steering_per_lateral_acceleration(speed, sum(lengths), gradient)
  return LateralFit(
    values=(float(values[0]), float(values[1])),
    covariance=tuple(tuple(row) for row in (covariance * np.outer(values, values)).tolist()),
    speed=speed,
    understeer_gradient=gradient,
    understeer_gradient_std=steady.gradient_std,
    steering_loss=steady.loss,
    steering_loss_std=steady.loss_std,
    steering_per_accel=float(exact) if printed_fit is None else printed_fit,
    printed_error_percent=float(100.0 * (printed / exact - 1.0)),
    nuisances=dict(nuisances),
    steps=tuple(_errors(turns, vehicle, values, "accel_y")),
    yaw_rate_steps=tuple(_errors(turns, vehicle, values, "yaw_rate")),
    notes=notes,
  )


def _errors(turns: Sequence[Turn], vehicle: MeasuredCar, values: Array, name: str) -> Iterator[StepError]:
  """Error of the plain bicycle on every step, from the step to the end of its response."""
  gradient = _gradient(values, vehicle)
  for turn in turns:
    if name not in turn.signals or turn.step.steady is None:
      continue
    modelled = LinearResponses([turn], vehicle).model(values)[name][0]
    wanted = moving_average(turn.signals[name])
    rmse = float(np.sqrt(np.mean(np.square(wanted - modelled)[turn.step.first :])))
    speed, measured = turn.steady("speed"), turn.steady(name)
    wheelbase = vehicle.cg_to_front + vehicle.cg_to_rear
    model = float(turn.steady("steering") * kinematics.yaw_rate_gain(speed, wheelbase, gradient))
    model = model * speed if name == "accel_y" else model
    step = turn.step
    yield StepError(step.recording, step.role, step.level, measured, model, rmse, 100.0 * rmse / abs(measured))
