"""The identified single-track model as pure functions of state, commands and numbers.

State x = [X, Y, v, psi, beta, r] (see `State`), commands u = [V, delta] (drive command, steering). The drive
command is a motor voltage [V] in the paper; for a car whose drive takes a duty [-], a current [A] or a speed [m/s] it
is that, and P1 is per unit of it.
Everything broadcasts: x is (..., 6), u is (..., 2), every number of `SingleTrackCar` is a scalar or (...).

Drive: omega' = P1 V - P2 omega - P3 sgn(omega), v = G R_w omega. Friction is set-valued at rest: the
motor stays at rest while |P1 V| <= P3.
Lateral (C per axle, N/rad; |v| makes it hold in reverse):
  beta' = -((C_f + C_r) / (m |v|) + v'/v) beta - ((C_f L_f - C_r L_r) / (m |v| v) + 1) r + C_f delta / (m |v|)
  r'    = (-sgn(v) (C_f L_f - C_r L_r) beta - (C_f L_f^2 + C_r L_r^2) r / |v| + sgn(v) C_f L_f delta) / I
Position: X' = v cos(psi + beta), Y' = v sin(psi + beta), psi' = r.
Below `LOW_SPEED` the lateral part passes smoothly into the motion of tyres that don't slip, and is that
motion alone below half of it: there the tyres' time constants are under 2 ms and divisions by v end.

Source: Caponio et al., eqs. (1)-(3). Its text exchanges P1 and P2 in their physical meaning
(P1 = K_t / (J R_a), P2 = (K_t K_v / R_a + B) / J) and divides by R_w where it must multiply.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_twin import kinematics

Array = NDArray[np.float64]
Quantity = Array | float

LOW_SPEED = 0.2  # m/s: the paper's equations hold unchanged above it
KINEMATIC_TIME = 0.002  # s: how fast beta and r follow the no-slip motion below LOW_SPEED / 2


class State:
  """Where each quantity lives in the state vector."""

  POSE_X, POSE_Y, SPEED, POSE_YAW, SIDESLIP_ANGLE, YAW_RATE = range(6)
  POSITION = slice(0, 2)
  LATERAL = slice(4, 6)  # (sideslip angle, yaw rate)
  NAMES = ("pose_x", "pose_y", "speed", "pose_yaw", "sideslip_angle", "yaw_rate")
  SIZE = 6


@dataclasses.dataclass(frozen=True)
class SingleTrackCar:
  """Numbers of the model; scalars, or arrays that broadcast against the state's leading shape.

  Attributes:
    drive_gain: P1, rad/s^2/V, or per unit of another drive command.  drive_damping: P2, 1/s.
    drive_friction: P3, rad/s^2 (motor side).
    cornering_stiffness_front, cornering_stiffness_rear: per axle, N/rad.
    mass: kg.  yaw_inertia: kg m^2.  cg_to_front, cg_to_rear: m.
    rolling_radius: G R_w, metres of travel per radian of the motor.
  """

  drive_gain: Quantity
  drive_damping: Quantity
  drive_friction: Quantity
  cornering_stiffness_front: Quantity
  cornering_stiffness_rear: Quantity
  mass: Quantity
  yaw_inertia: Quantity
  cg_to_front: Quantity
  cg_to_rear: Quantity
  rolling_radius: Quantity


# -- drive ---------------------------------------------------------------------------------------


def motor_speed_after(
  motor_speed: Quantity,
  command: Quantity,
  duration: Quantity,
  drive_gain: Quantity,
  drive_damping: Quantity,
  drive_friction: Quantity,
) -> Array:
  """Motor speed [rad/s] after a constant drive command has acted for `duration` [s]; exact.

  omega(t) = omega_0 e^(-P2 t) + a (1 - e^(-P2 t)) / P2 with a = P1 V - P3 sgn(omega) while the sign
  holds; it reaches zero after log(1 - P2 omega_0 / a) / P2, and from there it rests or goes the other way.
  """
  push = np.asarray(drive_gain) * command
  forward = np.sign(motor_speed)
  held = push - drive_friction * forward  # deceleration has the sign opposite to the motion
  # a push of next to nothing stops the motor after as good as infinite time
  with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
    stop = np.log1p(-drive_damping * np.asarray(motor_speed) / held) / drive_damping
  stop = np.where(forward == 0.0, 0.0, np.where(held * forward < 0.0, stop, np.inf))
  free = np.maximum(np.abs(push) - drive_friction, 0.0) * np.sign(push)  # away from rest
  moving = _relax(motor_speed, held, duration, drive_damping)
  departing = _relax(0.0, free, np.maximum(duration - stop, 0.0), drive_damping)
  return np.where(stop < duration, departing, moving)


def _relax(start: Quantity, push: Quantity, duration: Quantity, rate: Quantity) -> Array:
  """x(duration) of x' = push - rate x, x(0) = start."""
  decay = -np.asarray(rate) * duration
  return start * np.exp(decay) - push * np.expm1(decay) / rate


def acceleration(speed: Quantity, command: Quantity, car: SingleTrackCar) -> Array:
  """v' [m/s^2] = G R_w (P1 V - P2 omega - P3 sgn(omega)); zero at rest while friction holds."""
  push = np.asarray(car.drive_gain) * command
  motor_speed = np.asarray(speed) / car.rolling_radius
  moving = push - car.drive_damping * motor_speed - car.drive_friction * np.sign(motor_speed)
  resting = np.sign(push) * np.maximum(np.abs(push) - car.drive_friction, 0.0)
  return car.rolling_radius * np.where(motor_speed == 0.0, resting, moving)


# -- lateral -------------------------------------------------------------------------------------


def slipping_share(speed: Quantity) -> Array:
  """Share of the dynamic equations, 0 below LOW_SPEED / 2 and 1 above LOW_SPEED."""
  size = np.abs(np.asarray(speed, dtype=np.float64))
  part = np.clip(2.0 * size / LOW_SPEED - 1.0, 0.0, 1.0)
  return part * part * (3.0 - 2.0 * part)


def _floored(speed: Quantity) -> tuple[Array, Array]:
  """Signed and absolute speed kept at least LOW_SPEED / 2 away from zero."""
  size = np.maximum(np.abs(speed), 0.5 * LOW_SPEED)
  return np.where(np.asarray(speed) < 0.0, -size, size), size


def lateral_system(speed: Quantity, accel: Quantity, car: SingleTrackCar) -> tuple[Array, Array]:
  """Matrix (..., 2, 2) and steering input (..., 2) of the slipping car, for z = (beta, r).

  `speed` [m/s] signed, at least LOW_SPEED / 2 in size (smaller ones are taken as that);
  `accel` is v' [m/s^2].
  """
  v, size = _floored(speed)
  direction = np.sign(v)
  front, rear = car.cornering_stiffness_front, car.cornering_stiffness_rear
  ahead = np.asarray(front) * car.cg_to_front
  skew = ahead - np.asarray(rear) * car.cg_to_rear
  damping = ahead * car.cg_to_front + rear * np.square(car.cg_to_rear)
  matrix = (
    -(np.asarray(front) + rear) / (car.mass * size) - accel / v,
    -skew / (car.mass * size * v) - 1.0,
    -direction * skew / car.yaw_inertia,
    -damping / (car.yaw_inertia * size),
  )
  matrix = np.stack(np.broadcast_arrays(*matrix), axis=-1)
  steering = front / (car.mass * size), direction * ahead / car.yaw_inertia
  return matrix.reshape(*matrix.shape[:-1], 2, 2), np.stack(np.broadcast_arrays(*steering), axis=-1)


def no_slip_motion(speed: Quantity, steering: Quantity, car: SingleTrackCar) -> Array:
  """(beta, r) of tyres that don't slip, (..., 2): rad, rad/s."""
  sideslip = kinematics.kinematic_sideslip_angle(steering, car.cg_to_front, car.cg_to_rear)
  yaw_rate = kinematics.kinematic_yaw_rate(speed, steering, car.cg_to_front, car.cg_to_rear)
  return np.stack(np.broadcast_arrays(sideslip, yaw_rate), axis=-1)


def _blended(speed: Quantity, accel: Quantity, steering: Quantity, car: SingleTrackCar) -> tuple[Array, Array]:
  """Matrix (..., 2, 2) and constant (..., 2) of z' = A z + c at any speed."""
  share = slipping_share(speed)
  matrix, gain = lateral_system(speed, accel, car)
  follow = (1.0 - share) / KINEMATIC_TIME
  constant = share[..., None] * gain * np.asarray(steering)[..., None]
  constant = constant + follow[..., None] * no_slip_motion(speed, steering, car)
  return share[..., None, None] * matrix - follow[..., None, None] * np.eye(2), constant


class Transition(NamedTuple):
  """Lateral motion over a constant speed and steering: z(h) = flow z + forced, yaw turned = turn z + turned."""

  flow: Array  # (..., 2, 2)
  forced: Array  # (..., 2)
  turn: Array  # (..., 2)
  turned: Array  # (...)


def lateral_transition(
  speed: Quantity, accel: Quantity, steering: Quantity, duration: float, car: SingleTrackCar
) -> Transition:
  """Exact transition of z = (beta, r) over `duration` [s]; speed [m/s], v' [m/s^2], steering [rad] constant.

  z(h) = e^(A h) z + I_1 c, integral of z = I_1 z + I_2 c. A speed that changes is frozen at its mid value:
  an error of third order in h.
  """
  matrix, constant = _blended(speed, accel, steering, car)
  flow, once, twice = exponential_integrals(matrix, duration)
  return Transition(flow, _apply(once, constant), once[..., 1, :], _apply(twice, constant)[..., 1])


def _apply(matrix: Array, vector: Array) -> Array:
  return np.einsum("...ij,...j->...i", matrix, vector)


def exponential_integrals(matrix: Array, duration: float) -> tuple[Array, Array, Array]:
  """e^(A h) and its first and second integral over [0, h], for real A (..., 2, 2); any A, also singular.

  Each is f(A h) = f(l2) I + f[l1, l2] (A h - l2 I) with f = e^z, h (e^z - 1)/z, h^2 (e^z - 1 - z)/z^2 and
  the divided differences f[l1, l2] that follow from one another, |l1| >= |l2| the eigenvalues of A h.
  """
  scaled = matrix * duration
  mean = 0.5 * np.trace(scaled, axis1=-2, axis2=-1)
  rest = scaled - mean[..., None, None] * np.eye(2)
  half = np.sqrt((rest[..., 0, 0] ** 2 + rest[..., 0, 1] * rest[..., 1, 0]).astype(np.complex128))
  half = np.where(mean < 0.0, -half, half)
  large, small = mean + half, mean - half
  exp_slope = np.exp(small) * _phi(large - small)[1]
  values = _phi(small)
  by_large = np.where(np.abs(large) < 1e-3, 1.0, large)
  tiny = np.abs(large) < 1e-3
  once_slope = np.where(tiny, 1 / 2 + (large + small) / 6.0, (exp_slope - values[1]) / by_large)
  twice_slope = np.where(tiny, 1 / 6 + (large + small) / 24.0, (once_slope - values[2]) / by_large)
  slopes = exp_slope, once_slope, twice_slope
  offset = scaled - small[..., None, None] * np.eye(2)
  full = (v[..., None, None] * np.eye(2) + s[..., None, None] * offset for v, s in zip(values, slopes, strict=True))
  flow, once, twice = (f.real for f in full)
  return flow, duration * once, duration**2 * twice


def _phi(z: Array) -> tuple[Array, Array, Array]:
  """e^z, (e^z - 1)/z and (e^z - 1 - z)/z^2 of complex z, by series near zero."""
  near = np.abs(z) < 0.1
  safe = np.where(near, 1.0, z)
  first = np.where(near, _series(z, 1), np.expm1(safe) / safe)
  return np.exp(z), first, np.where(near, _series(z, 2), (first - 1.0) / safe)


def _series(z: Array, order: int) -> Array:
  """Sum of z^k / (k + order)! by Horner's rule, exact to rounding for |z| < 0.1."""
  total = np.zeros_like(z)
  for k in range(9, -1, -1):
    total = total * z + 1.0 / math.factorial(k + order)
  return total


# -- state ---------------------------------------------------------------------------------------


def derivative(x: Quantity, u: Quantity, car: SingleTrackCar) -> Array:
  """x' = f(x, u), (..., 6)."""
  x, u = np.asarray(x, dtype=np.float64), np.asarray(u, dtype=np.float64)
  speed, course = x[..., State.SPEED], x[..., State.POSE_YAW] + x[..., State.SIDESLIP_ANGLE]
  accel = acceleration(speed, u[..., 0], car)
  matrix, constant = _blended(speed, accel, u[..., 1], car)
  lateral = _apply(matrix, x[..., State.LATERAL]) + constant
  rates = speed * np.cos(course), speed * np.sin(course), accel, x[..., State.YAW_RATE]
  return np.concatenate([np.stack(np.broadcast_arrays(*rates), axis=-1), lateral], axis=-1)


def step(x: Quantity, u: Quantity, duration: float, car: SingleTrackCar) -> Array:
  """State after the commands have been held for `duration` [s], (..., 6)."""
  x, u = np.asarray(x, dtype=np.float64), np.asarray(u, dtype=np.float64)
  batch = np.broadcast_shapes(x.shape[:-1], u.shape[:-1], *(np.shape(number) for number in vars(car).values()))
  return steps(np.broadcast_to(x, (*batch, State.SIZE)), np.broadcast_to(u, (1, *batch, 2)), duration, car)[-1]


def steps(x: Array, u: Array, duration: float, car: SingleTrackCar) -> Array:
  """States after each of the commands u (T, ..., 2), held for `duration` [s] one after the other, (T, ..., 6).

  Two half steps each, exact in omega and exact in (beta, r, psi) at the speed of its middle; position by Simpson's
  rule. Stable at any speed and any stiffness. Speed does not ask for the lateral motion: speeds come first, then all
  transitions at once, and what is left to do in order is one product per half step.

  `x` is (..., 6) with all axes of the batch; numbers of the car broadcast against (...) or, by period, (T, ...).
  """
  half, count = 0.5 * duration, 2 * len(u)
  numbers = [np.broadcast_to(n, u.shape[:-1]) for n in (car.drive_gain, car.drive_damping, car.drive_friction)]
  motor_speed, lateral = np.empty((count + 1, *x.shape[:-1])), np.empty((count + 1, *x.shape[:-1], 2))
  motor_speed[0], lateral[0] = x[..., State.SPEED] / car.rolling_radius, x[..., State.LATERAL]
  for k in range(count):
    command, *now = (value[k // 2] for value in (u[..., 0], *numbers))
    motor_speed[k + 1] = motor_speed_after(motor_speed[k], command, half, *now)
  begun = np.stack([motor_speed[:-1:2], motor_speed[1::2]])  # (2, T, ...), first and second halves
  middle = motor_speed_after(begun, u[..., 0], 0.5 * half, *numbers) * car.rolling_radius
  change = lateral_transition(middle, acceleration(middle, u[..., 0], car), u[..., 1], half, car)
  for k in range(count):
    lateral[k + 1] = _apply(change.flow[k % 2, k // 2], lateral[k]) + change.forced[k % 2, k // 2]
  turn = np.sum(change.turn * np.stack([lateral[:-1:2], lateral[1::2]]), axis=-1) + change.turned
  states = np.empty((count + 1, *x.shape))
  states[0], states[..., State.LATERAL] = x, lateral
  states[1:, ..., State.SPEED] = motor_speed[1:] * car.rolling_radius
  states[1:, ..., State.POSE_YAW] = np.swapaxes(turn, 0, 1).reshape(motor_speed[1:].shape)
  states[..., State.POSE_YAW] = np.cumsum(states[..., State.POSE_YAW], axis=0)
  knots = _velocity(states)
  moved = duration / 6.0 * (knots[:-1:2] + 4.0 * knots[1::2] + knots[2::2])
  states[2::2, ..., State.POSITION] = x[..., State.POSITION] + np.cumsum(moved, axis=0)
  return states[2::2]


def _velocity(x: Array) -> Array:
  course = x[..., State.POSE_YAW] + x[..., State.SIDESLIP_ANGLE]
  return x[..., State.SPEED, None] * np.stack([np.cos(course), np.sin(course)], axis=-1)
