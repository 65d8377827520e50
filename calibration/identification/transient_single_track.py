"""Cornering stiffness from the first third of a second after a step of the steering.

A quick step of 7 degrees throws the front tyres to nearly 7 degrees of slip before the car has begun to yaw:
outside the range in which force is proportional to slip, and within the time in which servo and carcass still
move. A linear, lag-free model fitted to it misses the stiffness the tyre has at small slip by up to a half.
So the transient is answered here by a single track with a saturating tyre, transient slip and a servo:

  m (v_y' + v r) = F_f cos(delta) + F_r,  I r' = L_f F_f cos(delta) - L_r F_r
  sigma / v alpha' = slip - alpha,  F = -C a (1 - s + s^2 / 3), a = alpha + t_c alpha', s = |C a| / (3 mu F_z)
  delta'' = w^2 (command - delta) - 1.5 w delta',  w = 1.5 / T_servo

(brush tyre: Pacejka 2012, 3.2). C_f is fitted; C_r follows from the understeer gradient K of the steady
turns. mu, T_servo, sigma and t_c are fitted too, each held by a prior. K and the measured numbers of the car
are not: fitted, they would bend to whatever this model still lacks; their deviations pass into the result's.
Amplitudes are left free per run and channel: shape only, the steady turns give the amplitude.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calibration.identification.step_detection import PERIOD
from qcar_twin import kinematics
from qcar_twin.vehicle.similarity import Similarity
from qcar_twin.vehicle.vehicle import GRAVITY

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Quantity = Array | float

SUBSTEPS = 4  # of a period, of the QCar's class; Runge-Kutta, stable for servos slower than 0.0014 s
BEFORE, AFTER = 10, 35  # periods simulated before the step and after it


@dataclasses.dataclass(frozen=True)
class Unknown:
  """A quantity of the fit with its prior: value = mean exp(std z), or mean + std z, z standard normal."""

  name: str
  mean: float
  std: float  # relative if logarithmic
  logarithmic: bool = True
  lowest: float = -np.inf
  fitted: bool = True  # else it stays at its mean and its deviation is passed on

  def value(self, z: Array) -> Array:
    if self.logarithmic:
      return np.maximum(self.mean * np.exp(self.std * z), self.lowest)
    return np.maximum(self.mean + self.std * z, self.lowest)


@dataclasses.dataclass(frozen=True, eq=False)
class Transients:
  """Step steers cut around the step, on the 10 ms grid; row BEFORE is where the new command begins to act.

  Attributes:
    steering: command, rad, (S, T).  speed: m/s, (S, T).
    measured: "yaw_rate" [rad/s] and/or "accel_y" [m/s^2], free of bias, (S, T).
    noise: standard deviation of each channel's samples.
  """

  steering: Array
  speed: Array
  measured: Mapping[str, Array]
  noise: Mapping[str, float]


@dataclasses.dataclass(frozen=True, eq=False)
class TransientFit:
  """Outcome.

  Attributes:
    values: every unknown by name.
    stiffness: C_f, C_r, N/rad.
    covariance: of their logarithms, (2, 2), from noise, priors and measured numbers.
    without: shift of their logarithms when one run is left out, by one Gauss-Newton step, (S, 2).
    by_gradient: d log(C_f, C_r) / dK, (2,).
    chi_squared: per degree of freedom, of the samples.
  """

  values: dict[str, float]
  stiffness: tuple[float, float]
  covariance: Array
  without: Array
  by_gradient: Array
  chi_squared: float


def unknowns(
  numbers: Mapping[str, float], std: Mapping[str, float], gradient: float, gradient_std: float
) -> tuple[Unknown, ...]:
  """What is fitted, with priors. `numbers`: measured mass, yaw_inertia, cg_to_front, cg_to_rear, imu_x.

  The spread of C_f covers a factor of ten either way of what 10 N/rad per newton of load gives.
  """
  size = Similarity.of(numbers["cg_to_front"] + numbers["cg_to_rear"])
  load = numbers["mass"] * GRAVITY * numbers["cg_to_rear"] / (numbers["cg_to_front"] + numbers["cg_to_rear"])
  fitted = (
    Unknown("cornering_stiffness_front", 10.0 * load, 0.8),
    Unknown("understeer_gradient", gradient, gradient_std, logarithmic=False, fitted=False),
    Unknown("friction_coefficient", 0.9, 0.35),
    Unknown("servo_time", 0.005 * size.time, 0.4, lowest=0.0015),
    Unknown("relaxation_length", 0.010 * size.length, 0.3, lowest=0.002 * size.length),
    Unknown("carcass_time", 0.001, 0.001, logarithmic=False, lowest=0.0),
  )
  return fitted + tuple(Unknown(n, value, std[n], logarithmic=False, fitted=False) for n, value in numbers.items())


def rear_stiffness(
  front: Quantity, gradient: Quantity, mass: Quantity, cg_to_front: Quantity, cg_to_rear: Quantity
) -> Array:
  """C_r [N/rad] that gives the understeer gradient K with this C_f: L_f / (L_r / C_f - K L / m)."""
  inverse = cg_to_rear / front - gradient * (cg_to_front + cg_to_rear) / mass
  return cg_to_front / np.maximum(inverse, 1e-3 * cg_to_rear / front)


def responses(numbers: Mapping[str, Array], steering: Array, speed: Array) -> dict[str, Array]:
  """Yaw rate [rad/s] and lateral specific force at the IMU [m/s^2], (n, S, T), of numbers (n,)."""
  column = {name: np.asarray(value)[..., None] for name, value in numbers.items()}
  car = _Car(column)
  state = np.zeros((6, *np.broadcast_shapes(column["mass"].shape, steering[:, 0].shape)))
  sideslip = kinematics.kinematic_sideslip_angle(steering[:, 0], column["cg_to_front"], column["cg_to_rear"])
  state[0] = speed[:, 0] * np.tan(sideslip)
  state[1] = kinematics.kinematic_yaw_rate(speed[:, 0], steering[:, 0], column["cg_to_front"], column["cg_to_rear"])
  state[4] = steering[:, 0]
  yaw_rate, accel_y = [], []
  substeps = Similarity.of(float(np.mean(column["cg_to_front"] + column["cg_to_rear"]))).steps(SUBSTEPS)
  step = PERIOD / substeps
  for k in range(steering.shape[1]):
    v, command = np.maximum(speed[:, k], 0.1), steering[:, k]
    rate, felt = car.derivative(state, v, command)
    yaw_rate.append(state[1])
    accel_y.append(felt + column["imu_x"] * rate[1])
    for _ in range(substeps):
      first, _ = car.derivative(state, v, command)
      second, _ = car.derivative(state + 0.5 * step * first, v, command)
      third, _ = car.derivative(state + 0.5 * step * second, v, command)
      fourth, _ = car.derivative(state + step * third, v, command)
      state = state + step / 6.0 * (first + 2.0 * (second + third) + fourth)
  return {"yaw_rate": np.stack(yaw_rate, axis=-1), "accel_y": np.stack(accel_y, axis=-1)}


class _Car:
  """Equations of the module's head for columns of numbers (n, 1); state (v_y, r, alpha_f, alpha_r, delta, delta')."""

  def __init__(self, n: Mapping[str, Array]):
    self._n = n
    self._front = n["cornering_stiffness_front"]
    self._rear = rear_stiffness(self._front, n["understeer_gradient"], n["mass"], n["cg_to_front"], n["cg_to_rear"])
    unit = 3.0 * n["friction_coefficient"] * n["mass"] * GRAVITY / (n["cg_to_front"] + n["cg_to_rear"])
    self._limit_front, self._limit_rear = unit * n["cg_to_rear"], unit * n["cg_to_front"]
    self._servo = 1.5 / n["servo_time"]

  def derivative(self, state: Array, speed: Array, command: Array) -> tuple[Array, Array]:
    """Rates (6, n, S), and the lateral acceleration of the centre of gravity [m/s^2]."""
    n = self._n
    v_y, r, alpha_f, alpha_r, delta, turning = state
    roll = speed / n["relaxation_length"]
    rates = np.empty_like(state)
    rates[2] = roll * (np.arctan((v_y + n["cg_to_front"] * r) / speed) - delta - alpha_f)
    rates[3] = roll * (np.arctan((v_y - n["cg_to_rear"] * r) / speed) - alpha_r)
    force_f = brush_force(self._front * (alpha_f + n["carcass_time"] * rates[2]), self._limit_front) * np.cos(delta)
    force_r = brush_force(self._rear * (alpha_r + n["carcass_time"] * rates[3]), self._limit_rear)
    accel = (force_f + force_r) / n["mass"]
    rates[0] = accel - speed * r
    rates[1] = (n["cg_to_front"] * force_f - n["cg_to_rear"] * force_r) / n["yaw_inertia"]
    rates[4] = turning
    rates[5] = self._servo * (self._servo * (command - delta) - 1.5 * turning)
    return rates, accel


def brush_force(linear: Array, limit: Array) -> Array:
  """Force of a brush tyre [N] from its linear force [N] and three times its peak: opposite, -linear (1 - s + s^2/3)."""
  slide = np.clip(linear / limit, -1.0, 1.0)
  return -limit * slide * (1.0 - np.abs(slide) + slide * slide / 3.0)


def fit_transients(transients: Transients, parameters: Sequence[Unknown]) -> TransientFit:
  """Maximum a posteriori of the fitted unknowns; Jacobian columns ride in one batch.

  If the residuals exceed the noise, the noise is raised to them and the fit repeated: a model that is
  wrong by that much may not outvote the priors.
  """
  fitted = np.flatnonzero([p.fitted for p in parameters])
  z = _optimum(transients, parameters, fitted, _possible(parameters))
  chi_squared = _chi_squared(transients, parameters, fitted, z)
  if chi_squared > 1.0:
    louder = {name: float(np.sqrt(chi_squared)) * value for name, value in transients.noise.items()}
    transients = dataclasses.replace(transients, noise=louder)
    z = _optimum(transients, parameters, fitted, z)
  return dataclasses.replace(_evaluate(transients, parameters, fitted, z), chi_squared=chi_squared)


def _possible(parameters: Sequence[Unknown]) -> Array:
  """Where the fit begins, (n,): the means, with C_f half of what no rear axle can balance where its mean is more.

  A car that understeers by K has C_f < m L_r / (K L); beyond it the cost has no slope.
  """
  start, mean = np.zeros(len(parameters)), {p.name: p.mean for p in parameters}
  steer = mean["understeer_gradient"] * (mean["cg_to_front"] + mean["cg_to_rear"])
  at = [p.name for p in parameters].index("cornering_stiffness_front")
  if steer > 0.0 and parameters[at].mean * steer >= mean["mass"] * mean["cg_to_rear"]:
    half = 0.5 * mean["mass"] * mean["cg_to_rear"] / steer
    start[at] = np.log(half / parameters[at].mean) / parameters[at].std
  return start


def _optimum(transients: Transients, parameters: Sequence[Unknown], fitted: Indices, start: Array) -> Array:
  """Position of the maximum; a hundredth of a prior deviation is close enough."""
  size = len(fitted)
  latest: dict[bytes, Array] = {}

  def whole(y: Array) -> Array:
    z = np.zeros((*y.shape[:-1], len(parameters)))
    z[..., fitted] = y
    return z

  def residuals(y: Array) -> Array:
    moves = 1e-4 * np.concatenate([np.zeros((1, size)), np.eye(size), -np.eye(size)])
    rows = np.concatenate([_whitened(transients, parameters, whole(y + moves)), y + moves], axis=-1)
    latest.clear()
    latest[y.tobytes()] = (rows[1 : size + 1] - rows[size + 1 :]).T / 2e-4  # the Jacobian rides along
    return rows[0]

  def jacobian(y: Array) -> Array:
    if y.tobytes() not in latest:
      residuals(y)
    return latest[y.tobytes()]

  accuracy = {"xtol": 1e-2, "ftol": 1e-6, "gtol": 1e-2}
  optimum = least_squares(residuals, start[fitted], jac=jacobian, **accuracy)  # pyright: ignore[reportArgumentType]
  return whole(optimum.x)


def _chi_squared(transients: Transients, parameters: Sequence[Unknown], fitted: Indices, z: Array) -> float:
  residuals = _whitened(transients, parameters, z[None])[0]
  return float(residuals @ residuals) / max(len(residuals) - len(fitted), 1)


def _evaluate(transients: Transients, parameters: Sequence[Unknown], fitted: Indices, z: Array) -> TransientFit:
  """Covariance at the optimum: posterior of the fitted, plus what the measured numbers may move it by."""
  sensitivity = _sensitivity(transients, parameters, z, np.arange(len(z)))
  own, given = sensitivity[:, fitted], np.setdiff1d(np.arange(len(z)), fitted)
  posterior = np.linalg.inv(own.T @ own + np.eye(len(fitted)))
  moves = np.zeros((len(z), len(z)))  # standard moves of all unknowns, one a column
  moves[np.ix_(fitted, fitted)] = np.linalg.cholesky(posterior)
  moves[np.ix_(fitted, given)] = -posterior @ own.T @ sensitivity[:, given]
  moves[given, given] = 1.0
  slopes = np.stack([_log_stiffness(parameters, z + 1e-4 * e) for e in np.eye(len(z))], axis=-1)
  slopes = (slopes - _log_stiffness(parameters, z)[:, None]) / 1e-4  # (2, P)
  shifts = slopes @ moves
  gradient = [p.name for p in parameters].index("understeer_gradient")
  residuals = _whitened(transients, parameters, z[None])[0]
  left_out = _left_out(own, residuals, z[fitted], len(transients.steering))
  front, rear = np.exp(_log_stiffness(parameters, z))
  return TransientFit(
    values={name: float(value[0]) for name, value in _numbers(parameters, z[None]).items()},
    stiffness=(float(front), float(rear)),
    covariance=shifts @ shifts.T,
    without=left_out @ slopes[:, fitted].T,
    by_gradient=shifts[:, gradient] / parameters[gradient].std,
    chi_squared=float("nan"),
  )


def _left_out(own: Array, residuals: Array, z: Array, runs: int) -> Array:
  """Gauss-Newton step of the fitted unknowns when each run is left out, (S, F)."""
  run = np.tile(np.repeat(np.arange(runs), AFTER), len(residuals) // (runs * AFTER))
  steps = []
  for left in range(runs):
    kept = run != left
    information = own[kept].T @ own[kept] + np.eye(len(z))
    steps.append(-np.linalg.solve(information, own[kept].T @ residuals[kept] + z))
  return np.array(steps)


def _sensitivity(transients: Transients, parameters: Sequence[Unknown], z: Array, columns: Indices) -> Array:
  """d whitened samples / dz for some unknowns, (M, F), by central differences in one batch."""
  moves = 1e-4 * np.eye(len(z))[columns]
  moved = _whitened(transients, parameters, np.concatenate([z + moves, z - moves]))
  return (moved[: len(columns)] - moved[len(columns) :]).T / 2e-4


def _numbers(parameters: Sequence[Unknown], z: Array) -> dict[str, Array]:
  return {p.name: p.value(z[:, k]) for k, p in enumerate(parameters)}


def _log_stiffness(parameters: Sequence[Unknown], z: Array) -> Array:
  n = _numbers(parameters, z[None])
  front = n["cornering_stiffness_front"]
  rear = rear_stiffness(front, n["understeer_gradient"], n["mass"], n["cg_to_front"], n["cg_to_rear"])
  return np.log(np.array([front[0], rear[0]]))


def _whitened(transients: Transients, parameters: Sequence[Unknown], z: Array) -> Array:
  """(measured - gain model) / noise after the step, (n, M) for z (n, P); the gain of each run and channel is fitted."""
  model = responses(_numbers(parameters, z), transients.steering, transients.speed)
  parts = []
  for name, measured in transients.measured.items():
    wanted, modelled = measured[:, BEFORE:], model[name][..., BEFORE:]
    gain = np.sum(wanted * modelled, axis=-1) / np.sum(np.square(modelled), axis=-1)
    scaled = (wanted - gain[..., None] * modelled) / transients.noise[name]
    parts.append(scaled.reshape(len(z), -1))
  return np.concatenate(parts, axis=-1)
