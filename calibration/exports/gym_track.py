"""The dynamic single track of CommonRoad and f1tenth_gym, which their parameter files are read by.

State x: position [m], steering angle [rad], speed [m/s], heading [rad], yaw rate [rad/s], sideslip [rad]. Inputs of
that model are steering rate and acceleration. The drive line and the servo are not in it; here an acceleration comes
from the voltage, a = G R (P1 V - P2 v / (G R) - P3 sgn v), and the steering goes to its command at most at sv_max.

  r' = mu / (I L) (a C_Sf (g b - u h) (delta m a - ...)): linear tyres, stiffness mu C_S F_z, load by acceleration

Source: Althoff, Koschi and Manzinger, CommonRoad: composable benchmarks for motion planning on roads, IEEE IV 2017, and
its Vehicle Models, sec. 7 (single track). Below `switch_speed` it is kinematic, and here in reverse, too, where that
model's own yaw damping changes its sign and it diverges.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = dict[str, Array | float]

PERIOD, PARTS = 0.01, 10  # s, and Runge-Kutta steps in it
GRAVITY = 9.81  # m/s^2, as in that model
SENSED = ("yaw_rate", "accel_x", "accel_y", "motor_speed", "steering_angle")


def at_start(car: Numbers, start: Array, command: Array) -> Array:
  """State (..., 7) of a car at (..., 7), in the order of `qcar_twin.plant.START`."""
  x, y, yaw, ahead, aside, rate, angle = np.moveaxis(start, -1, 0)
  speed = np.hypot(ahead, aside) * np.where(ahead < 0.0, -1.0, 1.0)
  slip = np.arctan2(aside * np.where(ahead < 0.0, -1.0, 1.0), np.maximum(np.abs(ahead), 1e-9))
  slip = np.where(speed < car["switch_speed"], _rolling(angle, car), slip)
  return np.stack([x, y, angle, speed, yaw, rate, slip], axis=-1)


def motion(x: Array) -> Array:
  """Position, heading, velocity in the car's axes, yaw rate, (..., 6)."""
  speed, slip = x[..., 3], x[..., 6]
  return np.stack([x[..., 0], x[..., 1], x[..., 4], speed * np.cos(slip), speed * np.sin(slip), x[..., 5]], axis=-1)


def step(x: Array, u: Array, car: Numbers) -> tuple[Array, Array]:
  """State after a period and what sensors show then (..., 5), from x (..., 7), voltage [V] and steering [rad]."""
  length = PERIOD / PARTS
  target = np.clip(u[..., 1], car["s_min"], car["s_max"])
  rates = x
  for _ in range(PARTS):
    rate = np.clip((target - x[..., 2]) / length, car["sv_min"], car["sv_max"])
    first = derivative(x, rate, u[..., 0], car)
    second = derivative(x + 0.5 * length * first, rate, u[..., 0], car)
    third = derivative(x + 0.5 * length * second, rate, u[..., 0], car)
    fourth = derivative(x + length * third, rate, u[..., 0], car)
    rates = (first + 2.0 * second + 2.0 * third + fourth) / 6.0
    after = x + length * rates
    turned_round = np.sign(after[..., 3]) * np.sign(x[..., 3]) < 0.0  # it stops first: friction may hold it
    after[..., 3] = np.where(turned_round, 0.0, after[..., 3])
    x = after
  kinematic = x[..., 3] < car["switch_speed"]
  slip = _rolling(x[..., 2], car)
  x[..., 6] = np.where(kinematic, slip, x[..., 6])
  turning = x[..., 3] * np.cos(slip) * np.tan(x[..., 2]) / (np.asarray(car["lf"]) + car["lr"])
  x[..., 5] = np.where(kinematic, turning, x[..., 5])
  speed, slip = x[..., 3], x[..., 6]
  along, across = rates[..., 3], speed * (rates[..., 6] + x[..., 5])
  across = np.where(kinematic, speed * x[..., 5], across)
  felt = np.cos(slip) * along - np.sin(slip) * across, np.sin(slip) * along + np.cos(slip) * across
  motor = speed * np.cos(slip) / car["travel_per_radian"]
  return x, np.stack(np.broadcast_arrays(x[..., 5], *felt, motor, x[..., 2]), axis=-1)


def derivative(x: Array, rate: Array, voltage: Array, car: Numbers) -> Array:
  """dx/dt, (..., 7), with the steering rate [rad/s] and the motor's voltage [V]."""
  angle, speed, yaw, turn, slip = np.moveaxis(x[..., 2:], -1, 0)
  along = acceleration(speed, voltage, car)
  front, rear = np.asarray(car["lf"]), np.asarray(car["lr"])
  kinematic = speed < car["switch_speed"]
  v = np.where(kinematic, car["switch_speed"], speed)
  grip = car["mu"] / (front + rear)
  at_front = grip * car["C_Sf"] * (GRAVITY * rear - along * car["h"])
  at_rear = grip * car.get("C_Sr", car["C_Sf"]) * (GRAVITY * front + along * car["h"])
  slips = angle - slip - front * turn / v, -slip + rear * turn / v
  turned = car["m"] / np.asarray(car["I"]) * (front * at_front * slips[0] - rear * at_rear * slips[1])
  slipped = (at_front * slips[0] + at_rear * slips[1]) / v - turn
  rolling = _rolling(angle, car)
  course = yaw + np.where(kinematic, rolling, slip)
  kinematic_turn = speed * np.cos(rolling) * np.tan(angle) / (front + rear)
  still = np.zeros_like(turned)
  return np.stack(
    np.broadcast_arrays(
      speed * np.cos(course), speed * np.sin(course), rate, along, np.where(kinematic, kinematic_turn, turn),
      np.where(kinematic, still, turned), np.where(kinematic, still, slipped),
    ),
    axis=-1,
  )  # fmt: skip


def acceleration(speed: Array, voltage: Array, car: Numbers) -> Array:
  """What the drive line gives, within -+a_max, m/s^2; friction holds a standing car."""
  travel = car["travel_per_radian"]
  push = travel * np.asarray(car["drive_gain"]) * voltage
  friction = travel * np.asarray(car["drive_friction"])
  moving = push - car["drive_damping"] * speed - friction * np.sign(speed)
  resting = np.sign(push) * np.maximum(np.abs(push) - friction, 0.0)
  return np.clip(np.where(speed == 0.0, resting, moving), -np.asarray(car["a_max"]), car["a_max"])


def _rolling(angle: Array, car: Numbers) -> Array:
  """Sideslip of a car whose tyres don't slip, rad."""
  return np.arctan(np.tan(angle) * car["lr"] / (np.asarray(car["lf"]) + car["lr"]))
