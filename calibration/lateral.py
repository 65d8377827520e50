"""Cornering stiffness of both axles from step steers: the paper's two-stage least squares, and an exact one.

"paper", as printed: steady lateral accelerations give k_su = delta / a_ys by least squares through the
origin; C_f in C_r = (k_su C_f L_f v^2 - C_f L_f^2) / L_r^2 minimises the mean squared error of the
transient lateral acceleration, both filtered alike. The constraint leaves sideslip out of the yaw equation.

"exact": steady yaw rates give the understeer gradient K of delta = (L + K v^2) r / v. Yaw rate rather than
lateral acceleration, because an IMU on a rolling body also feels g sin(roll), 2 % here, which passes for
understeer. The car steers less at large angles (coupled axles scrub, tyres bend), as the square of the angle;
K is the value at zero angle, where the linear model is meant, and what the square takes is kept beside it
(`TurningLosses`). C_f then comes from the shape of the transient (`step_steer`).
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from calibration import step_steer
from calibration.longitudinal import NotIdentifiable, StepError, student_widening
from calibration.steps import moving_average
from calibration.turns import LinearResponses, Turn, cut, find_turns
from qcar_twin import kinematics
from qcar_twin.bicycle import PARAMETERS, MeasuredCar
from qcar_twin.recording import Recording

Array = NDArray[np.float64]

TRANSIENT = 0.5  # s, duration of the transient in the printed cost
MEASURED = ("mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "imu_x")
UNMOVED = ("imu_y", "wheel_radius", "gear_ratio", "max_steering")
UNSTATED = {"mass": 0.01, "yaw_inertia": 0.10, "cg_to_front": 0.02, "cg_to_rear": 0.02, "wheel_radius": 0.01}
UNSTATED_IMU = 0.003  # m; the others relative
PRINTED_NOTE = (
  "as printed: stiffness that a linear car without servo or tyre lag needs; its deviations hold scatter and"
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
  recordings: Sequence[Recording], vehicle: MeasuredCar, std: Mapping[str, float], steady_state: str
) -> LateralFit:
  """C_f and C_r from the step steers with role "identify"; errors on all steps given.

  Args:
    vehicle: measured numbers.  std: their standard deviations by name; what is missing is taken as
      1 % of mass and wheel radius, 10 % of yaw inertia, 2 % of the semi-wheelbases, 3 mm of the IMU's place.
    steady_state: "exact" or "paper".

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
  if steady_state == "paper":
    return _as_printed(turns, used, vehicle, spread)
  return _exact(turns, used, vehicle, spread)


# -- as printed ----------------------------------------------------------------------------------


def _as_printed(
  turns: Sequence[Turn], used: Sequence[Turn], vehicle: MeasuredCar, std: Mapping[str, float]
) -> LateralFit:
  if not all("accel_y" in t.signals for t in used):
    raise NotIdentifiable("the paper's identification needs accel_y; use steady_state='exact', which takes yaw_rate")
  values, k_su, speed = _printed_stages(used, vehicle)
  logs = np.log([_printed_stages(_others(used, i), vehicle)[0] for i in range(len(used))])
  covariance = _jackknife_covariance(logs) + _measured_covariance(used, vehicle, std, values)
  steady = SteadyTurns(_gradient(values, vehicle), float("nan"))
  return _result(turns, vehicle, values, covariance, speed, steady, k_su, {}, (PRINTED_NOTE,))


def _printed_stages(used: Sequence[Turn], vehicle: MeasuredCar) -> tuple[Array, float, float]:
  """(C_f, C_r) [N/rad], k_su [rad s^2/m] and the mean speed [m/s]."""
  steering = np.array([t.steady("steering") for t in used])
  accel = np.array([t.steady("accel_y") for t in used])
  speed = float(np.mean([t.steady("speed") for t in used]))
  k_su = float(steering @ steering / (steering @ accel))
  front, rear = vehicle.cg_to_front, vehicle.cg_to_rear
  ratio = max((k_su * front * speed**2 - front**2) / rear**2, 0.05)  # C_r / C_f; keeps C_r positive
  about = [cut(t, TRANSIENT) for t in used]
  transient = LinearResponses(about, vehicle)
  wanted = [moving_average(t.signals["accel_y"]) for t in about]

  def cost(log_front: float) -> float:
    found = transient.model(np.exp(log_front) * np.array([1.0, ratio]))["accel_y"]
    pairs = zip(wanted, found, about, strict=True)
    return float(sum(np.mean(np.square(w - f)[t.step.first :]) for w, f, t in pairs))

  bounds = np.log([PARAMETERS["cornering_stiffness_front"].lower, PARAMETERS["cornering_stiffness_front"].upper])
  found = minimize_scalar(cost, bounds=tuple(bounds), method="bounded", options={"xatol": 1e-4})
  return np.exp(found.x) * np.array([1.0, ratio]), k_su, speed


def _measured_covariance(used: Sequence[Turn], vehicle: MeasuredCar, std: Mapping[str, float], values: Array) -> Array:
  """Covariance of log (C_f, C_r) from the standard deviations of the measured numbers: one refit each."""
  total = np.zeros((2, 2))
  for name in MEASURED:
    moved = SimpleNamespace(**{k: getattr(vehicle, k) for k in (*MEASURED, *UNMOVED)})
    setattr(moved, name, getattr(moved, name) + std[name])
    shift = np.log(_printed_stages(used, moved)[0] / values)  # pyright: ignore[reportArgumentType]
    total += np.outer(shift, shift)
  return total


# -- exact ---------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class SteadyTurns:
  """Understeer gradient K at zero angle [rad s^2/m], steering loss [1/rad^2], and their standard deviations."""

  gradient: float
  gradient_std: float
  loss: float = float("nan")
  loss_std: float = float("nan")


def _exact(turns: Sequence[Turn], used: Sequence[Turn], vehicle: MeasuredCar, std: Mapping[str, float]) -> LateralFit:
  steady = fit_steady_turns(used, vehicle, std)
  numbers = {name: getattr(vehicle, name) for name in MEASURED}
  unknowns = step_steer.unknowns(numbers, std, steady.gradient, steady.gradient_std)
  fit = step_steer.fit_transients(_transients(used), unknowns)
  moved = [fit_steady_turns(_others(used, i), vehicle, std).gradient - steady.gradient for i in range(len(used))]
  covariance = fit.covariance + _jackknife_covariance(fit.without + np.outer(moved, fit.by_gradient))
  speed = float(np.mean([t.steady("speed") for t in used]))
  k_su = kinematics.steering_per_lateral_acceleration(speed, vehicle.cg_to_front + vehicle.cg_to_rear, steady.gradient)
  note = f"transient fit: chi-squared per degree of freedom {fit.chi_squared:.2f}"
  return _result(turns, vehicle, np.array(fit.stiffness), covariance, speed, steady, float(k_su), fit.values, (note,))


def fit_steady_turns(used: Sequence[Turn], vehicle: MeasuredCar, std: Mapping[str, float]) -> SteadyTurns:
  """delta (1 - loss delta^2) = (L + K v^2) r / v, least squares over steady turns.

  K_i = (delta_i v_i / r_i - L) / v_i^2 = K + c delta_i^2 with c = loss (L + K v^2) / v^2 (K alone for fewer
  than four turns), weighted by delta_i^2 because the error of r_i is the same for every turn. The deviation
  of K adds to the scatter what wheelbase and wheel radius were measured to.
  """
  angle = np.array([t.steady("steering") for t in used])
  speed = np.array([t.steady("speed") for t in used])
  yaw_rate = np.array([t.yaw_rate for t in used])
  wheelbase, squared = vehicle.cg_to_front + vehicle.cg_to_rear, float(np.mean(np.square(speed)))
  each = (angle * speed / yaw_rate - wheelbase) / np.square(speed)
  powers = 2 if len(used) >= 4 else 1
  design = np.stack([np.square(angle) ** k for k in range(powers)], axis=-1) * np.abs(angle)[:, None]
  solution, *_ = np.linalg.lstsq(design, each * np.abs(angle), rcond=None)
  freedom = max(len(used) - powers, 1)
  scatter = float(np.sum(np.square(each * np.abs(angle) - design @ solution))) / freedom
  variance = scatter * np.diag(np.linalg.inv(design.T @ design)) * student_widening(freedom) ** 2
  from_radius = wheelbase / squared * std["wheel_radius"] / vehicle.wheel_radius
  from_length = np.hypot(std["cg_to_front"], std["cg_to_rear"]) / squared
  gradient, deviation = float(solution[0]), float(np.sqrt(variance[0] + from_radius**2 + from_length**2))
  if powers == 1:
    return SteadyTurns(gradient, deviation)
  scale = squared / (wheelbase + gradient * squared)
  return SteadyTurns(gradient, deviation, float(solution[1] * scale), float(np.sqrt(variance[1]) * scale))


def _transients(used: Sequence[Turn]) -> step_steer.Transients:
  first = [t.step.first for t in used]
  rows = [np.clip(np.arange(k - step_steer.BEFORE, k + step_steer.AFTER), 0, None) for k in first]
  names = [name for name in ("yaw_rate", "accel_y") if all(name in t.signals for t in used)]

  def cut(values: Sequence[Array]) -> Array:
    return np.stack([v[np.minimum(r, len(v) - 1)] for v, r in zip(values, rows, strict=True)])

  noise = {name: float(np.sqrt(np.mean([_sample_noise(t, name) ** 2 for t in used]))) for name in names}
  return step_steer.Transients(
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


def _jackknife_covariance(estimates: Array) -> Array:
  """Covariance (2, 2) from estimates that leave out one run each, (n, 2), widened for their number."""
  count = len(estimates)
  if count < 3:
    return np.full((2, 2), np.nan)
  away = estimates - estimates.mean(axis=0)
  return (count - 1) / count * away.T @ away * student_widening(count - 1) ** 2


def _result(
  turns: Sequence[Turn],
  vehicle: MeasuredCar,
  values: Array,
  covariance: Array,
  speed: float,
  steady: SteadyTurns,
  k_su: float,
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
    steering_per_accel=k_su,
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
    found = LinearResponses([turn], vehicle).model(values)[name][0]
    wanted = moving_average(turn.signals[name])
    rmse = float(np.sqrt(np.mean(np.square(wanted - found)[turn.step.first :])))
    speed, measured = turn.steady("speed"), turn.steady(name)
    wheelbase = vehicle.cg_to_front + vehicle.cg_to_rear
    model = float(turn.steady("steering") * kinematics.yaw_rate_gain(speed, wheelbase, gradient))
    model = model * speed if name == "accel_y" else model
    step = turn.step
    yield StepError(step.recording, step.role, step.level, measured, model, rmse, 100.0 * rmse / abs(measured))
