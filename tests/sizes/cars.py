"""Cars of three sizes as an independent simulator drives them: a single track on sine tyres, nothing of the twin's.

  m (v_x' - v_y r) = F_x - F_f sin d     m (v_y' + v_x r) = F_f cos d + F_r     I r' = l_f F_f cos d - l_r F_r
  F = D sin(C atan(B alpha))

Numbers are published ones: 1:43 as in Liniger, Domahidi and Morari, Optimization-based autonomous racing of 1:43 scale
RC cars, Optimal Control Applications and Methods 36, 2015, and the parameters of their MPCC; 1:5 as in the AutoRally
platform's description (autorally_description, 2014); full size the BMW 320i of CommonRoad (Althoff and Wuersching,
CommonRoad: Vehicle Models, 2020, tables 6 and 7). Servos, sensors' noise and the 1:43 car's body are assumed; where
else they say nothing a line says what was assumed.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = 0.002  # s
GRAVITY = 9.81
CREEP = 0.05  # of the car's usual speed: slip angles are taken over no less, so that a standing car has some


@dataclasses.dataclass(frozen=True)
class Tyre:
  """Of an axle: F = D sin(C atan(B alpha)), D in N."""

  b: float
  c: float
  d: float

  def force(self, alpha: float) -> float:
    return self.d * float(np.sin(self.c * np.arctan(self.b * alpha)))


@dataclasses.dataclass(frozen=True)
class SizedCar:
  """One car.

  Attributes:
    command: column of the drive's command.  force: N along the car from command and speed [m/s].
    usual: speed that it is driven about, m/s.  servo: time constant, s.  servo_rate: rad/s.
    body: track, CG height, wheel radius [m] and gear ratio, where nobody needs them but who describes the car.
    noise: of speed [m/s], yaw rate [rad/s] and accelerations [m/s^2].  rate: of the log, Hz.
  """

  name: str
  mass: float
  yaw_inertia: float
  front: float
  rear: float
  tyres: tuple[Tyre, Tyre]
  command: str
  force: Callable[[float, float], float]
  hold: Callable[[float], float]
  usual: float
  lock: float
  servo: float
  servo_rate: float
  noise: tuple[float, float, float]
  rate: float
  body: tuple[float, float, float, float]

  @property
  def measured(self) -> dict[str, float]:
    """What a scale, a ruler and a data sheet say, by name of [vehicle]."""
    names = ("track_width", "cg_height", "wheel_radius", "gear_ratio")
    return {
      "mass": self.mass, "yaw_inertia": self.yaw_inertia, "cg_to_front": self.front, "cg_to_rear": self.rear,
      **dict(zip(names, self.body, strict=True)), "max_steering": self.lock, "servo_time_constant": self.servo,
    }  # fmt: skip

  @property
  def wheelbase(self) -> float:
    return self.front + self.rear


def _full_size_force(wanted: float, speed: float) -> float:
  """A cruise control of one second within 4 m/s^2, an assumption: CommonRoad's car is commanded an acceleration."""
  return 1093.3 * float(np.clip(wanted - speed, -4.0, 4.0))


def _fifth_force(duty: float, speed: float) -> float:
  """20 N m on wheels of 0.095 m, 26.8 m/s at the top, 0.5 N m of friction a wheel."""
  return 20.0 / 0.095 * (duty - speed / 26.8) - 4 * 0.5 / 0.095 * float(np.tanh(speed / 0.05))


def _small_force(duty: float, speed: float) -> float:
  """Published: (C_m1 - C_m2 v) d - C_r0 - C_r2 v^2."""
  return (0.287 - 0.0545 * speed) * duty - 0.0518 * float(np.tanh(speed / 0.02)) - 0.00035 * speed**2


def _commonroad_tyre(load: float) -> Tyre:
  """mu = 1.0489, C = 1.3507, B C D = 21.92 load."""
  return Tyre(21.92 / (1.3507 * 1.0489), 1.3507, 1.0489 * load)


def _fifth_tyre(load: float) -> Tyre:
  """mu = 0.75 as in the description; B C D = 10 load, assumed: between the 1:43's 5 and the BMW's 22."""
  return Tyre(10.0 / (1.3 * 0.75), 1.3, 0.75 * load)


def _loads(mass: float, front: float, rear: float) -> tuple[float, float]:
  return tuple(mass * GRAVITY * x / (front + rear) for x in (rear, front))  # type: ignore[return-value]


CARS: dict[str, SizedCar] = {
  "1:43": SizedCar(
    "1:43", 0.041, 27.8e-6, 0.029, 0.033, (Tyre(2.579, 1.2, 0.192), Tyre(3.3852, 1.2691, 0.1737)), "duty",
    _small_force, lambda v: (0.0518 + 0.00035 * v**2) / (0.287 - 0.0545 * v), 1.0, 0.35, 0.02, 20.0,
    (0.005, 0.03, 0.1), 100.0, (0.03, 0.012, 0.0075, 0.25),
  ),
  "1:5": SizedCar(  # mass with wheels; yaw inertia m l_f l_r, assumed: the description's is a thousandth of a box's
    "1:5", 23.92, 23.92 * 0.34 * 0.23, 0.34, 0.23, tuple(map(_fifth_tyre, _loads(23.92, 0.34, 0.23))), "duty",
    _fifth_force, lambda v: v / 26.8 + 0.1, 4.0, 0.3665, 0.03, 8.05, (0.02, 0.01, 0.15), 50.0,
    (0.4, 0.12, 0.095, 1.0 / 18.68),
  ),
  "full": SizedCar(
    "full", 1093.3, 1791.6, 1.1562, 1.4227, tuple(map(_commonroad_tyre, _loads(1093.3, 1.1562, 1.4227))),
    "speed_command", _full_size_force, lambda v: v, 12.0, 0.6, 0.1, 0.4, (0.03, 0.003, 0.1), 50.0,
    (1.375, 0.575, 0.344, 0.25),
  ),
}  # fmt: skip


def commands(car: SizedCar, seconds: float, seed: int) -> tuple[Array, Array, Array]:
  """Time (k,), drive and steering command of a drive that starts from rest: steps of speed, smooth steering.

  Lateral acceleration stays about 2.5 m/s^2, whatever the size.
  """
  random, time = np.random.default_rng(seed), np.arange(0.0, seconds, STEP)
  unit = np.sqrt(car.wheelbase / GRAVITY)  # s, Froude's
  speed = car.usual * np.repeat(random.uniform(0.6, 1.3, 64), int(12.0 * unit / STEP))[: time.size]
  speed = np.where(time < 1.0, 0.0, np.resize(speed, time.size))
  drive = np.array([car.hold(v) if v else 0.0 for v in speed])
  waves = [random.uniform(0.02, 0.12) / unit for _ in range(4)]
  wave = sum(np.sin(2.0 * np.pi * f * time + random.uniform(0.0, 6.3)) for f in waves)
  fast = np.maximum.accumulate(speed + 1.0 * time) - 1.0 * time  # a driver who waits for the car to slow down
  steering = 2.5 * car.wheelbase / np.maximum(fast, 0.6 * car.usual) ** 2 * 0.7 * np.asarray(wave)
  steering[time < 1.0] = 0.0
  return time, drive, np.clip(steering, -car.lock, car.lock)


def step(car: SizedCar, speed: float, accel_y: float) -> tuple[Array, Array, Array]:
  """As `commands`: from rest to a share of the usual speed, then to about that lateral acceleration, m/s^2."""
  seconds = 24.0 if car.command == "duty" else 30.0  # until the drive has settled
  time = np.arange(0.0, seconds, STEP)
  drive = np.where(time < 1.0, 0.0, car.hold(speed * car.usual))
  steering = np.where(time < 0.6 * seconds, 0.0, accel_y * car.wheelbase / (speed * car.usual) ** 2)
  return time, drive, steering


def drive(car: SizedCar, seconds: float, seed: int, given: tuple[Array, Array, Array] | None = None):
  """Columns of one log: what was commanded (`given`, or a drive by chance), and what noisy sensors say of it."""
  time, wanted, steering = given or commands(car, seconds, seed)
  states, felt = np.zeros((time.size, 4)), np.zeros((time.size, 2))
  state = np.zeros(4)  # v_x, v_y, yaw rate, road-wheel angle
  for k in range(time.size):
    states[k], felt[k] = state, _rates(car, state, wanted[k], steering[k])[1]
    half = state + 0.5 * STEP * _rates(car, state, wanted[k], steering[k])[0]
    state = state + STEP * _rates(car, half, wanted[k], steering[k])[0]
  return logged(car, time, wanted, steering, states, felt, seed)


def logged(car: SizedCar, time: Array, wanted: Array, steering: Array, states: Array, felt: Array, seed: int):
  """What a logger writes of a drive, at the car's rate and with its sensors' noise."""
  random, every = np.random.default_rng(seed + 1000), slice(0, None, round(1.0 / car.rate / STEP))
  noisy = lambda values, sigma: values[every] + sigma * random.standard_normal(values[every].size)
  return {
    "time (s)": time[every],
    car.command: wanted[every],
    "steering angle command (rad)": steering[every],
    "speed (m/s)": noisy(states[:, 0], car.noise[0]),
    "yaw rate (rad/s)": noisy(states[:, 2], car.noise[1]),
    "acceleration x (m/s^2)": noisy(felt[:, 0], car.noise[2]),
    "acceleration y (m/s^2)": noisy(felt[:, 1], car.noise[2]),
  }


def _rates(car: SizedCar, state: Array, wanted: float, steering: float) -> tuple[Array, Array]:
  """Rates of the state, and the accelerations felt at the centre of gravity."""
  vx, vy, r, d = state
  over = max(vx, CREEP * car.usual)
  front = car.tyres[0].force(d - np.arctan((vy + car.front * r) / over))
  rear = car.tyres[1].force(-np.arctan((vy - car.rear * r) / over))
  along = car.force(wanted, vx) if vx > 0.0 or wanted > 0.0 else 0.0
  ax, ay = (along - front * np.sin(d)) / car.mass, (front * np.cos(d) + rear) / car.mass
  turning = (car.front * front * np.cos(d) - car.rear * rear) / car.yaw_inertia
  servo = np.clip((steering - d) / car.servo, -car.servo_rate, car.servo_rate)
  return np.array([ax + vy * r, ay - vx * r, turning, servo]), np.array([ax, ay])
