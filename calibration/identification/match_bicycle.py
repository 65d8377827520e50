"""The twin fitted to the identified bicycle: same steps of the drive command, same step steers, same answers.

Steps of the drive command (voltage, duty, speed) start at rest and last 4.5 / P2, as the identification's responses
do. Step steers start at 1.5 m/s straight ahead with the command that holds this speed, and rise at 3 rad/s; the bicycle
answers them at the twin's own speed, as it does at the measured speed in the identification. Both pass the same
zero-phase moving average. Errors are root mean squares over the response, per cent of the bicycle's steady value.

Lateral acceleration is the motion's, v_y' + v_x r carried to the IMU's place: an accelerometer on the twin's
rolling body also feels g sin(roll), which a single track does not have.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.optimiser import Fit, fit, posterior_curvature, with_jacobian
from calibration.fitting.slopes import finite_differences
from calibration.identification.identification import Identification
from calibration.identification.step_detection import moving_average
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.bicycle.single_track import SingleTrackCar, lateral_transition
from qcar_twin.parameters import ParameterSet
from qcar_twin.plant import Segments
from qcar_twin.twin.parameters import drive_values
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.similarity import Similarity
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

# mass, lengths and inertia are the bicycle's own; the motor's inertia shows in no ratio a step response has; the shape
# is that of one tyre law
FITTED = (
  "motor_damping",
  "driveline_friction",
  "cornering_stiffness_front",
  "cornering_stiffness_rear",
  "longitudinal_stiffness",
  "friction_coefficient",
  "tyre_shape",
  "relaxation_length",
  "servo_time_constant",
  "ackermann_fraction",
)
SPEED = 1.5  # m/s, of the step steers; this and what follows of the QCar's class
SLEW = 3.0  # rad/s, at which the steering command of a step rises: at once it would slide the front tyres
BEFORE = 0.5  # s, straight ahead before a step steer
AFTER = 4.5  # s from its beginning, as long as the laboratory's
AIM = {"motor_speed": 0.005, "yaw_rate": 0.01, "accel_y": 0.01}  # share of the steady value that is one deviation
WITNESSES = 25.0  # independent samples a response counts as
PARTS = {"longitudinal": "motor_speed", "lateral": "accel_y", "yaw_rate": "yaw_rate"}


@dataclasses.dataclass(frozen=True)
class Level:
  """A step to answer: drive command [its unit] or steering angle [rad], and whether it is fitted or only judged."""

  value: float
  role: str


@dataclasses.dataclass(frozen=True)
class Answer:
  """Twin and bicycle on one step.

  Attributes:
    channel: "motor_speed" [rad/s], "accel_y" [m/s^2] or "yaw_rate" [rad/s].
    time: s since the step.  twin, bicycle: filtered responses on it, which are compared.
    steady: of the bicycle.
    drawn: the same responses of twin and bicycle before the filter, (2, T): they begin at the step, where a zero-phase
      filter begins half its length earlier.
  """

  channel: str
  level: Level
  time: Array
  twin: Array
  bicycle: Array
  steady: float
  drawn: Array

  @property
  def rmse_percent(self) -> float:
    """Root mean square difference over the response, per cent of the steady value."""
    shown = self.time >= 0.0
    return 100.0 * float(np.sqrt(np.mean(np.square(self.twin - self.bicycle)[shown]))) / abs(self.steady)


@dataclasses.dataclass(frozen=True)
class Match:
  """The twin fitted to a bicycle.

  Attributes:
    fit: of the drive's gain and FITTED, as far as the steps can show them; its covariance holds the bicycle's own.
    theta: full vector of the twin's parameters, (P,).
    answers: every step, fitted and judged.
  """

  fit: Fit
  theta: Array
  answers: tuple[Answer, ...]

  def rmse_percent(self, part: str, role: str | None = None) -> float:
    """Mean over steps: part "longitudinal", "lateral" or "yaw_rate"; NaN if there are none."""
    return mean_percent(self.answers, part, role)


def mean_percent(answers: Sequence[Answer], part: str, role: str | None = None) -> float:
  """Average error of a part's answers, per cent; NaN if there are none."""
  chosen = [a.rmse_percent for a in answers if a.channel == PARTS[part] and role in (None, a.level.role)]
  return float(np.mean(chosen)) if chosen else math.nan


class StepComparison:
  """The steps to answer, the twin's and the bicycle's answers to them."""

  def __init__(self, twin: Twin, bicycle: Bicycle, theta: Array, drives: Sequence[Level], angles: Sequence[Level]):
    """theta: the bicycle's parameters, (5,). Drive commands that don't move it are left out."""
    car = bicycle.car(theta)
    moving = lambda v: car.drive_gain * abs(v) > 1.05 * car.drive_friction
    self._twin, self._bicycle, self._rolling = twin, bicycle, float(car.rolling_radius)
    self.drives = tuple(level for level in drives if moving(level.value))
    self.angles = tuple(angles)
    self._runs: dict[str, Segments] = {}
    if self.drives:
      self._runs["drives"] = _drive_steps(
        [x.value for x in self.drives], float(4.5 / car.drive_damping), twin.vehicle.similarity
      )
    if self.angles:
      omega = step_speed(twin.vehicle) / self._rolling
      holding = float((car.drive_damping * omega + car.drive_friction) / car.drive_gain)
      self._runs["angles"] = _step_steers([x.value for x in self.angles], holding, twin.vehicle.similarity)
    if not self._runs:
      raise ValueError("nothing to compare: no step moves the identified bicycle and there is no steering step")

  def responses(self, theta: Array, bicycle_theta: Array) -> dict[str, tuple[Array, Array]]:
    """Channel -> (twin, bicycle) after the filter, each (n, S, T + 1), for twins (n, P) and a bicycle (5,)."""
    made = self.unfiltered(theta, bicycle_theta)
    return {channel: (moving_average(twin), moving_average(wanted)) for channel, (twin, wanted) in made.items()}

  def unfiltered(self, theta: Array, bicycle_theta: Array) -> dict[str, tuple[Array, Array]]:
    """The same responses as they are simulated."""
    out = {}
    if "drives" in self._runs:
      prediction = self._twin.rollout(theta, self._runs["drives"])
      wanted = self._bicycle.rollout(bicycle_theta, self._runs["drives"]).channel("motor_speed")
      motor_speed = prediction.channel("motor_speed")
      out["motor_speed"] = motor_speed, np.broadcast_to(wanted, motor_speed.shape)
    if "angles" in self._runs:
      out |= self._lateral(theta, bicycle_theta)
    return out

  def _lateral(self, theta: Array, bicycle_theta: Array) -> dict[str, tuple[Array, Array]]:
    segments, vehicle = self._runs["angles"], self._twin.vehicle
    twin = self._twin.rollout(theta, segments)
    speed = moving_average(twin.channel("motor_speed") * self._rolling, 0.2)
    car = self._bicycle.car(bicycle_theta)
    sideslip_angle, yaw_rate = single_track_answer(car, speed, segments.commands[..., 1], segments.period)
    answers = (
      (twin.channel("velocity_x"), twin.channel("velocity_y"), twin.channel("yaw_rate")),
      (speed * np.cos(sideslip_angle), speed * np.sin(sideslip_angle), yaw_rate),
    )
    accel = [planar_acceleration(*motion, vehicle, segments.period) for motion in answers]
    return {"accel_y": (accel[0], accel[1]), "yaw_rate": (answers[0][2], yaw_rate)}

  def steady(self, channel: str, bicycle: Array) -> Array:
    """Steady values of the bicycle's answers (..., S, T + 1): where they end."""
    return bicycle[..., -1] if channel == "motor_speed" else np.mean(bicycle[..., -50:], axis=-1)

  def levels(self, channel: str) -> tuple[Level, ...]:
    return self.drives if channel == "motor_speed" else self.angles

  def residual(self, theta: Array, bicycle_theta: Array) -> Array:
    """Differences of the fitted steps in deviations of AIM, (n, M)."""
    parts = []
    for channel, (twin, wanted) in self.responses(theta, bicycle_theta).items():
      fitted = [k for k, level in enumerate(self.levels(channel)) if level.role == "identify"]
      first = 0 if channel == "motor_speed" else int(BEFORE / self._twin.period)
      scale = AIM[channel] * np.abs(self.steady(channel, wanted)) * math.sqrt((twin.shape[-1] - first) / WITNESSES)
      error = (twin - wanted) / scale[..., None]
      parts.append(error[:, fitted, first:].reshape(len(twin), -1))
    return np.concatenate(parts, axis=-1)

  def answers(self, theta: Array, bicycle_theta: Array) -> tuple[Answer, ...]:
    """Every step of one parameter vector (P,)."""
    out = []
    for channel, raw in self.unfiltered(theta[None], bicycle_theta).items():
      twin, wanted = (moving_average(response) for response in raw)
      steady = self.steady(channel, wanted[0])
      before = 0.0 if channel == "motor_speed" else BEFORE
      time = self._twin.period * np.arange(twin.shape[-1]) - before
      for k, level in enumerate(self.levels(channel)):
        drawn = np.stack([response[0, k] for response in raw])
        out.append(Answer(channel, level, time, twin[0, k], wanted[0, k], float(steady[k]), drawn))
    return tuple(out)


def single_track_answer(car: SingleTrackCar, speed: Array, steering: Array, period: float) -> tuple[Array, Array]:
  """Sideslip angle [rad] and yaw rate [rad/s] of the bicycle, (n, S, T + 1), at given speeds.

  Args:
    speed: m/s, (n, S, T + 1).
    steering: angle held over each period, rad, (S, T).
  """
  middle = 0.5 * (speed[..., 1:] + speed[..., :-1])
  go = lateral_transition(
    middle, np.diff(speed, axis=-1) / period, np.broadcast_to(steering, middle.shape), period, car
  )
  motion = np.zeros((*speed.shape, 2))
  for k in range(middle.shape[-1]):
    motion[..., k + 1, :] = np.einsum("nsij,nsj->nsi", go.flow[:, :, k], motion[..., k, :]) + go.forced[:, :, k]
  return motion[..., 0], motion[..., 1]


def planar_acceleration(
  velocity_x: Array, velocity_y: Array, yaw_rate: Array, vehicle: Vehicle, period: float
) -> Array:
  """Lateral acceleration of the motion at the IMU's place, without g sin(roll), m/s^2; velocities of the CG in m/s."""
  across = np.gradient(velocity_y + vehicle.imu_x * yaw_rate, period, axis=-1)
  return across + velocity_x * yaw_rate - vehicle.imu_y * np.square(yaw_rate)


def levels_of(identification: Identification) -> tuple[list[Level], list[Level]]:
  """Drive commands and angles the identification was made with, each once."""
  lateral = identification.lateral.yaw_rate_steps or identification.lateral.steps if identification.lateral else ()
  return _distinct(identification.drive.steps), _distinct(lateral)


def match_bicycle(
  twin: Twin,
  identification: Identification,
  priors: ParameterSet,
  iterations: int = 12,
  progress: Callable[[int, float], None] | None = None,
) -> Match:
  """Fit the twin's step responses to the identified bicycle's.

  Args:
    twin: without mechanisms or with them at null.
    priors: the twin's base parameters.
    iterations: of the fit at most; it starts from the bicycle's own numbers.
    progress: called with the iteration and the cost.
  """
  bicycle, bicycle_theta = identification.bicycle(twin.vehicle)
  comparison = StepComparison(twin, bicycle, bicycle_theta, *levels_of(identification))
  wanted = (twin.vehicle.motor.gain, *(FITTED if comparison.angles else FITTED[:2]))
  names = [name for name in wanted if name in priors]
  free = ParameterSet(priors[name] for name in names)
  around = twin.parameters.vector({p.name: p.nominal for p in priors})
  columns = [twin.parameters.index(name) for name in names]

  def full(values: Array) -> Array:
    theta = np.tile(around, (len(values), 1))
    theta[:, columns] = values
    return theta

  def residual(values: Array) -> Array:
    return comparison.residual(full(values), bicycle_theta)

  first = free.vector({k: v for k, v in bicycle_values(identification, twin).items() if k in free})
  estimate = fit(residual, free, first, iterations, np.inf, tolerance=1e-3, progress=progress)
  estimate = with_jacobian(estimate, finite_differences(residual, free, estimate.theta, estimate.residual), np.inf)
  theta = full(estimate.theta[None])[0]
  moved = lambda bicycle: comparison.residual(theta[None], bicycle)[0]
  estimate = _with_bicycle(estimate, identification.covariance, moved, bicycle_theta)
  return Match(estimate, theta, comparison.answers(theta, bicycle_theta))


def bicycle_values(identification: Identification, twin: Twin) -> dict[str, float]:
  """The twin's parameters that a bicycle gives directly: drive per inertia, cornering stiffness."""
  values = drive_values(twin.vehicle, *identification.drive.values)
  if identification.lateral:
    front, rear = identification.lateral.values
    values |= {"cornering_stiffness_front": front, "cornering_stiffness_rear": rear}
  return values


def _with_bicycle(estimate: Fit, covariance: Array, residual: Callable[[Array], Array], theta: Array) -> Fit:
  """The fit with the bicycle's covariance carried over: cov + S C S', S = -H^-1 J' dr/db. The unknown counts as 0."""
  known = np.flatnonzero(np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0.0))
  if known.size == 0:
    return estimate
  r = residual(theta)
  moved = []
  for k in known:
    step = np.zeros(len(theta))
    step[k] = 1e-3 * (theta[k] or math.sqrt(covariance[k, k]))
    moved.append((residual(theta + step) - r) / step[k])
  curvature = posterior_curvature(estimate.jacobian, estimate.residual, estimate.theta, estimate.parameters, np.inf)
  scale = estimate.parameters.scale
  pull = (estimate.jacobian * scale).T @ np.stack(moved, axis=-1)
  shift = -scale[:, None] * np.linalg.solve(curvature * np.outer(scale, scale), pull)
  shift[estimate.at_bound] = 0.0
  return dataclasses.replace(
    estimate, covariance=estimate.covariance + shift @ covariance[np.ix_(known, known)] @ shift.T
  )


def step_speed(vehicle: Vehicle) -> float:
  """Of the step steers, m/s."""
  return SPEED * vehicle.similarity.speed


def _drive_steps(levels: Sequence[float], duration: float, similarity: Similarity, period: float = 0.01) -> Segments:
  """From rest, each drive command held."""
  length = int(np.clip(duration, 1.0, 8.0 * max(similarity.time, 1.0)) / period)
  commands = np.zeros((len(levels), length, 2))
  commands[:, :, 0] = np.array(levels)[:, None]
  return _segments(commands, 0.0, "drive", period)


def _step_steers(angles: Sequence[float], holding: float, similarity: Similarity, period: float = 0.01) -> Segments:
  """At `step_speed` under the drive command that holds it straight ahead, then each angle."""
  before, after = int(BEFORE / period), int(AFTER * max(similarity.time, 1.0) / period)
  commands = np.zeros((len(angles), before + after, 2))
  commands[:, :, 0] = holding
  size = np.minimum(SLEW / similarity.time * period * np.arange(1, after + 1), np.abs(angles)[:, None])
  commands[:, before:, 1] = np.sign(angles)[:, None] * size
  return _segments(commands, SPEED * similarity.speed, "angle", period)


def _segments(commands: Array, speed: float, name: str, period: float) -> Segments:
  size, length = commands.shape[:2]
  start = np.zeros((size, 7))
  start[:, 3] = speed
  names = tuple(f"{name}_{k}" for k in range(size))
  return Segments(commands, start, np.full(size, length), period, names, np.zeros(size))


def _distinct(steps) -> list[Level]:
  levels: dict[float, Level] = {}
  for step in steps:
    levels.setdefault(round(step.level, 4), Level(float(step.level), step.role))
  return list(levels.values())
