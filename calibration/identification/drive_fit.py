"""Drive of the car from steps of its command: the paper's two-stage least squares for P1, P2, P3.

The command V is a voltage in the paper; it may be a duty or a speed, and P1 is per unit of it.

Stage 1: steady motor speeds of held voltages, omega_s = m_l V - b_l, by linear least squares.
Stage 2: P2 minimises sum_j 1/T_j integral (omega_j - omega_hat_j(t; P2))^2 dt with P1 = m_l P2 and
P3 = b_l P2, discretised at 10 ms. omega_hat is the exact solution of the motor equation for the logged
voltages, T_j lasts until the response has settled, and measurement and model pass the same zero-phase
moving average. Voltages and speeds of both signs count by size (the model is odd).

Beyond the paper: what is left of the transient in a steady window, a share E = mean e^(-P2 t) of the step, is
taken off by the motor equation itself, omega_s = (mean omega - E omega_0) / (1 - E); the two stages are
repeated until P2 agrees with itself. A run that ends a little early then neither biases m_l nor P2.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter
from scipy.stats import norm
from scipy.stats import t as student

from calibration.identification.step_detection import (
  FILTER_TIME,
  PERIOD,
  Step,
  find_steps,
  moving_average,
  standard_error,
)
from qcar_twin.bicycle.bicycle import PARAMETERS
from qcar_twin.bicycle.single_track import motor_speed_after
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.drive import DRIVES, Drive

Array = NDArray[np.float64]

DRIFT = 0.005  # of the drive between the first and the last voltage step: 1 K of a copper winding is 0.4 %
STANDING = 0.02  # of the largest speed: a car below it does not move


class NotIdentifiable(ValueError):
  """The recordings don't determine these parameters; the text says what is missing."""


@dataclasses.dataclass(frozen=True)
class StepError:
  """How well the model answers one step.

  Attributes:
    level: held command, V or rad.
    measured, model: steady response (rad/s, or m/s^2); NaN where the response never settles.
    rmse: root mean square error over the response, in the unit of the response.
    rmse_percent: rmse over the size of the measured steady response (its peak where there is none), per cent.
  """

  recording: str
  role: str
  level: float
  measured: float
  model: float
  rmse: float
  rmse_percent: float


@dataclasses.dataclass(frozen=True)
class DriveFit:
  """P1, P2, P3 with their covariance (3, 3), the regression m_l [rad/s/V], b_l [rad/s], and every step's error."""

  values: tuple[float, float, float]
  covariance: tuple[tuple[float, ...], ...]
  slope: float
  offset: float
  steps: tuple[StepError, ...]
  notes: tuple[str, ...]


def fit_drive(
  recordings: Sequence[Recording], rolling_radius: float, scale_std: float = 0.0, drive: Drive = DRIVES["voltage"]
) -> DriveFit:
  """P1, P2, P3 from the steps of the drive command with role "identify"; errors on all steps given.

  Args:
    recordings: any; those whose manoeuvre is the drive's steps ("voltage_step") are used.
    rolling_radius: G R_w, m/rad; turns a logged `speed` into motor speed where there is no encoder.
    scale_std: relative standard deviation of rolling_radius; counts where only `speed` is logged.
    drive: what the motor is commanded with.

  Raises:
    NotIdentifiable: fewer than two settled levels that move the car, or a drive whose speed settles at none.
  """
  if not drive.steps:
    raise NotIdentifiable(
      f"the drive can't be identified from steps: under a constant {drive.channel} the speed does not settle"
    )
  steps, by_speed = motor_steps(recordings, rolling_radius, drive)
  used = [s for s in steps if s.role == "identify"]
  fastest = max((_size(s) for s in used), default=0.0)
  moving = [s for s in used if _size(s) > STANDING * fastest]
  settled = [s for s in moving if s.steady is not None]
  if len({round(abs(s.level), 3) for s in settled}) < 2:
    raise NotIdentifiable(
      f"the drive needs steady speeds at two levels of {drive.channel} or more; among {len(used)} steps with role"
      f" 'identify' {len(settled)} move the car and settle. "
      + (
        f"Record longer {drive.steps} runs at other levels"
        if used
        else f'Write manoeuvre = "{drive.steps}" at recordings of steps in dataset.toml, or record some'
      )
    )
  values, slope, offset = _two_stages(settled, moving)
  covariance = _jackknife(settled, moving, values) + _model_error(moving, values) + _drift(settled, values)
  if by_speed:
    covariance = covariance + scale_std**2 * np.outer([values[0], 0.0, values[2]], [values[0], 0.0, values[2]])
  errors = tuple(_step_error(s, values) for s in steps if _size(s) > STANDING * fastest)
  return DriveFit(
    (float(values[0]), float(values[1]), float(values[2])),
    tuple(tuple(row) for row in covariance.tolist()),
    slope,
    offset,
    errors,
    _notes(steps, used, moving, settled, fastest, by_speed),
  )


def motor_steps(
  recordings: Sequence[Recording], rolling_radius: float, drive: Drive = DRIVES["voltage"]
) -> tuple[list[Step], bool]:
  """Steps of the drive command with a "motor_speed" each, and whether it was made from the vehicle's speed."""
  runs = [r for r in recordings if r.manoeuvre == drive.steps]
  levels = [float(np.max(np.abs(r[drive.channel].value))) for r in runs if drive.channel in r]
  smallest = 0.05 * max(levels, default=0.0)
  encoder = [r for r in runs if "motor_speed" in r]
  if encoder:
    return list(find_steps(encoder, drive.channel, "motor_speed", smallest, start_at_rest=True)), False
  steps = find_steps(runs, drive.channel, "speed", smallest, start_at_rest=True)
  as_motor = [
    dataclasses.replace(s, measured={**s.measured, "motor_speed": s.measured["speed"] / rolling_radius}) for s in steps
  ]
  return as_motor, True


def _size(step: Step) -> float:
  """Speed reached: the mean over the last tenth of the response."""
  values = step.measured["motor_speed"]
  return float(np.abs(np.mean(values[-max(1, len(values) // 10) :])))


def _two_stages(settled: Sequence[Step], moving: Sequence[Step]) -> tuple[Array, float, float]:
  responses, damping, slope, offset = Responses(moving), np.inf, 0.0, 0.0
  bounds = np.log([PARAMETERS["drive_damping"].lower, PARAMETERS["drive_damping"].upper])
  for _ in range(12):
    slope, offset = steady_regression(settled, damping)
    direction = np.array([slope, 1.0, offset])
    optimum = minimize_scalar(
      lambda log_p2, direction=direction: responses.cost(np.exp(log_p2) * direction),
      bounds=tuple(bounds),
      method="bounded",
      options={"xatol": 1e-6},
    )
    damping, before = float(np.exp(optimum.x)), damping
    if abs(damping / before - 1.0) < 1e-4:
      break
  return damping * np.array([slope, 1.0, offset]), slope, offset


def steady_speed(step: Step, damping: float) -> float:
  """Size of the motor speed a held voltage leads to, |omega_s| [rad/s], from the step's steady window."""
  left = float(np.mean(np.exp(-damping * step.time[step.steady])))
  return abs(step.steady_mean("motor_speed") - left * _start_speed(step)) / (1.0 - left)


def steady_regression(settled: Sequence[Step], damping: float) -> tuple[float, float]:
  """m_l [rad/s/V] and b_l [rad/s] of omega_s = m_l V - b_l; b_l is kept from falling below zero."""
  volts = np.array([np.mean(np.abs(s.commands[s.steady, 0])) for s in settled])
  speeds = np.array([steady_speed(s, damping) for s in settled])
  slope, intercept = np.polyfit(volts, speeds, 1)
  if intercept > 0.0:
    return float(volts @ speeds / (volts @ volts)), 0.0
  return float(slope), float(-intercept)


class Responses:
  """Measured step responses, turned to positive speeds, and the model's answers, simulated side by side."""

  def __init__(self, steps: Sequence[Step]):
    rows = [_response_rows(s) for s in steps]
    length = max(r.stop - r.start for r in rows)
    signs = [np.sign(s.level) for s in steps]
    zipped = list(zip(signs, steps, rows, strict=True))
    self._command = np.stack([_padded(sign * s.commands[r, 0], length) for sign, s, r in zipped])  # (S, T)
    self._start = np.array([sign * _start_speed(s) for sign, s, _ in zipped])
    self.measured = [moving_average(sign * s.measured["motor_speed"][r]) for sign, s, r in zipped]

  def model(self, values: Array) -> list[Array]:
    """Filtered motor speed [rad/s] of P1, P2, P3 for every step."""
    held = np.flatnonzero(np.any(values[0] * self._command[:, :-1] <= values[2], axis=0))
    free = int(held[-1]) + 1 if held.size else 0  # from here on every voltage beats friction
    if np.any(self._start < 0.0):
      free = self._command.shape[1] - 1
    traces = np.empty(self._command.shape)
    traces[:, 0] = self._start
    for k in range(free):
      traces[:, k + 1] = motor_speed_after(traces[:, k], self._command[:, k], PERIOD, *values)
    traces[:, free:] = self._moving(values, traces[:, free], free)
    return [moving_average(t[: len(m)]) for t, m in zip(traces, self.measured, strict=True)]

  def _moving(self, values: Array, start: Array, first: int) -> Array:
    """Speeds from row `first` on, (S, T - first), of cars that never stop: exact, as one linear recursion
    omega_k+1 = E omega_k + (1 - E) (P1 V_k - P3) / P2 with E = e^(-P2 h)."""
    keep = np.exp(-values[1] * PERIOD)
    target = (values[0] * self._command[:, first:-1] - values[2]) / values[1]
    rest, _ = lfilter([1.0 - keep], [1.0, -keep], target, axis=-1, zi=(keep * start)[:, None])
    return np.concatenate([start[:, None], rest], axis=-1)

  def cost(self, values: Array) -> float:
    """Sum over steps of the time-averaged squared error, (rad/s)^2."""
    pairs = zip(self.measured, self.model(values), strict=True)
    return float(sum(np.mean(np.square(measured - model)) for measured, model in pairs))


def _response_rows(step: Step) -> slice:
  """From the step until 1.5 times the settling time (5 % of the steady speed), or to the end if it never settles."""
  if step.steady is None:
    return slice(step.first, len(step.time))
  steady = step.steady_mean("motor_speed")
  away = np.abs(moving_average(step.measured["motor_speed"], 0.2) - steady) > 0.05 * abs(steady)
  outside = np.flatnonzero(away[step.first : step.steady.start])
  settling = int(outside[-1]) + 1 if outside.size else 0
  return slice(step.first, min(step.first + max(int(1.5 * settling), int(0.5 / PERIOD)), len(step.time)))


def _padded(values: Array, length: int) -> Array:
  return np.pad(values, (0, length - len(values)), mode="edge")


def _start_speed(step: Step) -> float:
  """Motor speed at the step, rad/s: a line through the last tenth of a second; at rest unless the car clearly moves."""
  values = step.measured["motor_speed"]
  rows = np.arange(max(step.first - int(0.1 / PERIOD), 0), step.first + 1)
  line = np.polyfit(rows - step.first, values[rows], 1 if len(rows) > 3 else 0)
  return float(line[-1]) if abs(line[-1]) > STANDING * _size(step) else 0.0


def _jackknife(settled: Sequence[Step], moving: Sequence[Step], values: Array) -> Array:
  """Covariance (3, 3) of P1, P2, P3 by leaving out each recording in turn; see `jackknife_covariance`.

  What differs from run to run (noise, heat, the model's own error at other voltages) shows in it.
  """
  names = sorted({s.recording for s in settled})
  if len(names) < 3:
    return np.full((3, 3), np.nan)
  kept = [[[s for s in group if s.recording != name] for group in (settled, moving)] for name in names]
  return jackknife_covariance(np.array([_two_stages(*pair)[0] for pair in kept])) + np.diag(1e-12 * values**2)


def _model_error(moving: Sequence[Step], values: Array) -> Array:
  """Covariance (3, 3) from what the fit leaves over, taken as one error common to all times and runs.

  Heat, charge, tyre slip act equally in every run: leaving out runs does not show them. An error of the size
  of the residual and the shape of d omega / d log P2 moves log P2 by rms(residual) / rms(sensitivity).
  """
  responses, step = Responses(moving), 1e-3
  model, moved = responses.model(values), responses.model(values * (1.0 + step))
  left = sum(np.mean(np.square(w - m)) for w, m in zip(responses.measured, model, strict=True))
  felt = sum(np.mean(np.square(n - m)) for n, m in zip(moved, model, strict=True)) / step**2
  return left / felt * np.outer(values, values)


def _drift(settled: Sequence[Step], values: Array) -> Array:
  """Covariance (3, 3) from drift of the drive with heat and charge, which no fit of the steps can see.

  Voltages are mostly driven in rising order, so a drift of DRIFT over them turns the line omega_s(V) about
  its middle: log m_l moves by DRIFT, b_l by DRIFT m_l times the mean voltage.
  """
  volts = float(np.mean([np.mean(np.abs(s.commands[s.steady, 0])) for s in settled]))
  move = DRIFT * np.array([values[0], 0.0, values[0] * volts])
  return np.outer(move, move)


def jackknife_covariance(estimates: Array) -> Array:
  """Covariance (p, p) from n estimates that leave out one run each, (n, p).

  Few runs know their own spread badly: it is widened so that two standard deviations of the estimate keep the 95.4 %
  they have for many (Student). Two runs or fewer leave it unknown (NaN).
  Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 11.
  """
  count, size = estimates.shape
  if count < 3:
    return np.full((size, size), np.nan)
  away = estimates - estimates.mean(axis=0)
  return (count - 1) / count * away.T @ away * student_widening(count - 1) ** 2


def student_widening(freedom: int) -> float:
  """Factor on a standard deviation with so many degrees of freedom that keeps 2 of it at 95.4 %."""
  return float(student.ppf(norm.cdf(2.0), freedom) / 2.0)


def _step_error(step: Step, values: Array) -> StepError:
  responses = Responses([step])
  measured, model = responses.measured[0], responses.model(values)[0]
  rmse = float(np.sqrt(np.mean(np.square(measured - model))))
  steady = predicted = float("nan")
  if step.steady is not None:
    steady = np.sign(step.steady_mean("motor_speed")) * steady_speed(step, values[1])
    volts = float(np.mean(step.commands[step.steady, 0]))
    predicted = float(np.sign(volts) * max(values[0] * abs(volts) - values[2], 0.0) / values[1])
  size = abs(steady) if np.isfinite(steady) else float(np.max(np.abs(measured)))
  return StepError(step.recording, step.role, step.level, steady, predicted, rmse, 100.0 * rmse / size)


def _notes(
  steps: Sequence[Step],
  used: Sequence[Step],
  moving: Sequence[Step],
  settled: Sequence[Step],
  fastest: float,
  by_speed: bool,
) -> tuple[str, ...]:
  notes = []
  still = sorted({s.recording for s in steps if _size(s) <= STANDING * fastest})
  if still:
    notes.append(f"the car does not move in {', '.join(still)}: left out")
  unsettled = sorted({s.recording for s in moving if s.steady is None})
  if unsettled:
    notes.append(f"not settled at the end, used for the transient only: {', '.join(unsettled)}")
  if by_speed:
    notes.append("no motor_speed is logged: it is taken as speed / (gear_ratio wheel_radius)")
  if len({s.recording for s in settled}) < 3:
    notes.append(f"only {len(settled)} of {len(used)} steps settle: standard deviations are unknown")
  worst = max(standard_error(s.measured["motor_speed"][s.steady]) for s in settled)
  notes.append(f"steady speeds are means with standard errors up to {worst:.2g} rad/s; filter {FILTER_TIME:g} s")
  return tuple(notes)
