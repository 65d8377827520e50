"""Step steers as they are compared with a model: speed, bias-free signals, steady means, the bicycle's answer."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.identification.drive_fit import student_widening
from calibration.identification.step_detection import FILTER_TIME, PERIOD, Step, find_steps, moving_average
from qcar_twin import kinematics
from qcar_twin.bicycle.bicycle import MeasuredCar
from qcar_twin.bicycle.single_track import SingleTrackCar, lateral_system, lateral_transition
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

SMALLEST = float(np.deg2rad(1.5))  # rad, a smaller angle is no step


@dataclasses.dataclass(frozen=True, eq=False)
class Turn:
  """One step steer: the step, speeds [m/s] and bias-free signals on its grid, and its steady means."""

  step: Step
  speed: Array
  signals: Mapping[str, Array]

  def steady(self, name: str) -> float:
    values = {"speed": self.speed, "steering": self.step.commands[:, 1]} | dict(self.signals)
    return float(np.mean(values[name][self.step.steady]))

  @property
  def yaw_rate(self) -> float:
    """Steady yaw rate, rad/s; from the lateral acceleration where there is no gyro."""
    return self.steady("yaw_rate") if "yaw_rate" in self.signals else self.steady("accel_y") / self.steady("speed")


def find_turns(recordings: Sequence[Recording], vehicle: MeasuredCar) -> list[Turn]:
  """Every step steer that has a speed and a lateral channel, its biases taken off."""
  runs = [r for r in recordings if r.manoeuvre == "steering_step"]
  turns = []
  for run in runs:
    lateral = [name for name in ("yaw_rate", "accel_y") if name in run]
    if lateral and ("motor_speed" in run or "speed" in run):
      steps = find_steps([run], "steering_command", lateral[0], SMALLEST, start_at_rest=False)
      turns += [_turn(step, lateral, vehicle) for step in steps]
  return turns


def _turn(step: Step, lateral: Sequence[str], vehicle: MeasuredCar) -> Turn:
  if "motor_speed" in step.measured:
    speed = kinematics.road_speed(step.measured["motor_speed"], vehicle)
  else:
    speed = step.measured["speed"]
  speed = moving_average(_filled(speed), 2.0 * FILTER_TIME)
  rolling = kinematics.kinematic_yaw_rate(speed, step.commands[:, 1], vehicle.cg_to_front, vehicle.cg_to_rear)
  expected = {"yaw_rate": rolling, "accel_y": speed * rolling}
  before = slice(min(20, step.first // 3), step.first)
  signals = {}
  for name in lateral:
    values = _filled(step.measured[name])
    bias = np.mean(values[before] - expected[name][before]) if step.first else 0.0
    signals[name] = values - bias
  return Turn(step, speed, signals)


def _filled(values: Array) -> Array:
  """Values with the ends, where the channel is not logged, held."""
  there = np.flatnonzero(np.isfinite(values))
  return np.interp(np.arange(len(values)), there, values[there])


def cut(turn: Turn, after: float, before: float = 0.1) -> Turn:
  """From `before` to `after` seconds about the step."""
  rows = slice(max(turn.step.first - int(before / PERIOD), 0), turn.step.first + int(after / PERIOD))
  step = dataclasses.replace(
    turn.step,
    time=turn.step.time[rows],
    commands=turn.step.commands[rows],
    measured={name: values[rows] for name, values in turn.step.measured.items()},
    steady=None,
  )
  return Turn(step, turn.speed[rows], {name: values[rows] for name, values in turn.signals.items()})


class LinearResponses:
  """Answers of the bicycle to step steers at the measured speed; exact over each period."""

  def __init__(self, turns: Sequence[Turn], vehicle: MeasuredCar):
    self._vehicle, self._lengths = vehicle, [len(t.speed) for t in turns]
    length = max(self._lengths)

    def grid(values: Sequence[Array]) -> Array:
      return np.stack([np.pad(v, (0, length - len(v)), mode="edge") for v in values])

    limit = vehicle.max_steering
    self._speed = grid([t.speed for t in turns])
    self._accel = grid([np.gradient(t.speed, PERIOD) for t in turns])
    self._steering = np.clip(grid([t.step.commands[:, 1] for t in turns]), -limit, limit)

  def model(self, stiffness: Array) -> dict[str, list[Array]]:
    """Filtered yaw_rate [rad/s] and accel_y at the IMU [m/s^2] of every step for (C_f, C_r) [N/rad]."""
    car, vehicle = _car(stiffness, self._vehicle), self._vehicle
    middle = 0.5 * (self._speed[:, 1:] + self._speed[:, :-1])
    go = lateral_transition(middle, self._accel[:, :-1], self._steering[:, :-1], PERIOD, car)
    lateral = np.zeros((*self._speed.shape, 2))
    for k in range(self._speed.shape[1] - 1):
      lateral[:, k + 1] = np.einsum("sij,sj->si", go.flow[:, k], lateral[:, k]) + go.forced[:, k]
    matrix, gain = lateral_system(self._speed, self._accel, car)
    acted = np.concatenate([self._steering[:, :1], self._steering[:, :-1]], axis=-1)  # a row precedes its own command
    rates = np.einsum("stij,stj->sti", matrix, lateral) + gain * acted[..., None]
    yaw_rate = lateral[..., 1]
    across = self._speed * (rates[..., 0] + yaw_rate)
    along_body, accel = kinematics.body_to_world(lateral[..., 0], self._accel, across)
    place = vehicle.imu_x, vehicle.imu_y
    _, accel = kinematics.transport_acceleration(along_body, accel, yaw_rate, rates[..., 1], *place)
    named = {"yaw_rate": yaw_rate, "accel_y": accel}
    return {k: [moving_average(v[:n]) for v, n in zip(rows, self._lengths, strict=True)] for k, rows in named.items()}


def _car(stiffness: Array, vehicle: MeasuredCar) -> SingleTrackCar:
  numbers = vehicle.mass, vehicle.yaw_inertia, vehicle.cg_to_front, vehicle.cg_to_rear
  return SingleTrackCar(1.0, 1.0, 0.0, stiffness[0], stiffness[1], *numbers, kinematics.rolling_radius(vehicle))


@dataclasses.dataclass(frozen=True)
class SteadyTurns:
  """Understeer gradient K at zero angle [rad s^2/m], steering loss [1/rad^2], and their standard deviations."""

  gradient: float
  gradient_std: float
  loss: float = float("nan")
  loss_std: float = float("nan")


def fit_steady_turns(
  used: Sequence[Turn], vehicle: MeasuredCar, std: Mapping[str, float], with_loss: bool
) -> SteadyTurns:
  """delta (1 - loss delta^2) = (L + K v^2) r / v, least squares over steady turns.

  delta_i v_i / r_i - L = K v_i^2 + loss delta_i^3 v_i / r_i is linear in both (K alone if not `with_loss`); rows
  are weighted by delta_i because the error of r_i is the same for every turn. The deviation of K adds to the
  scatter what wheelbase and wheel radius were measured to.
  """
  angle = np.array([t.steady("steering") for t in used])
  speed = np.array([t.steady("speed") for t in used])
  per_rate = angle * speed / np.array([t.yaw_rate for t in used])
  wheelbase, squared = vehicle.cg_to_front + vehicle.cg_to_rear, float(np.mean(np.square(speed)))
  columns = [np.square(speed), np.square(angle) * per_rate] if with_loss else [np.square(speed)]
  design = np.stack(columns, axis=-1) * np.abs(angle)[:, None]
  wanted = (per_rate - wheelbase) * np.abs(angle)
  solution, *_ = np.linalg.lstsq(design, wanted, rcond=None)
  freedom = max(len(used) - len(columns), 1)
  scatter = float(np.sum(np.square(wanted - design @ solution))) / freedom
  variance = scatter * np.diag(np.linalg.inv(design.T @ design)) * student_widening(freedom) ** 2
  from_radius = wheelbase / squared * std["wheel_radius"] / vehicle.wheel_radius
  from_length = np.hypot(std["cg_to_front"], std["cg_to_rear"]) / squared
  gradient, deviation = float(solution[0]), float(np.sqrt(variance[0] + from_radius**2 + from_length**2))
  if not with_loss:
    return SteadyTurns(gradient, deviation)
  return SteadyTurns(gradient, deviation, float(solution[1]), float(np.sqrt(variance[1])))


def turning_drag(turns: Sequence[Turn], drive: Sequence[float], vehicle: MeasuredCar) -> tuple[float, float]:
  """Drag of `TurningLosses` [rad/s^2 per rad^2] and its standard deviation, from the voltage that steady turns need.

  P1 V - P2 omega - P3 = offset + drag delta^2, least squares over the steady turns and the straight stretches
  before them; the offset takes up what heat and charge have changed since the voltage steps. NaN for fewer
  than three turns.
  """
  if len(turns) < 3:
    return float("nan"), float("nan")
  points = [p for turn in turns for p in _unexplained(turn, drive, vehicle)]
  squared, excess = np.array(points).T
  design = np.stack([np.ones_like(squared), squared], axis=-1)
  solution, *_ = np.linalg.lstsq(design, excess, rcond=None)
  scatter = float(np.sum(np.square(excess - design @ solution))) / (len(points) - 2)
  return float(solution[1]), float(np.sqrt(scatter * np.linalg.inv(design.T @ design)[1, 1]))


def _unexplained(turn: Turn, drive: Sequence[float], vehicle: MeasuredCar) -> list[tuple[float, float]]:
  """(delta^2 [rad^2], P1 V - P2 omega - P3 [rad/s^2]) of the steady turn and of the stretch before the step."""
  motor_speed = kinematics.motor_speed(turn.speed, vehicle)
  volts, angle = turn.step.commands.T
  rows = [turn.step.steady]
  if turn.step.first > 0.5 / PERIOD:
    rows.append(slice(turn.step.first // 3, turn.step.first))
  return [
    (
      float(np.mean(np.square(angle[r]))),
      float(drive[0] * np.mean(volts[r]) - drive[1] * np.mean(motor_speed[r]) - drive[2]),
    )
    for r in rows
  ]
