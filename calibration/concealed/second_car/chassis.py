"""A rigid chassis in space on four struts, four wheels that spin: x' = f(t, x) for n cars at once.

Newton and Euler in the chassis' own axes, m (v' + w x v) = F, I w' + w x I w = M; it is turned by yaw,
pitch and roll in this order (ISO 8855: x forward, y left, z up, so that a positive pitch lowers the nose).
Floor axes: those of the room turned by the yaw. A strut stands upright between its corner and the floor and carries the
load at rest plus spring and damper; tyre forces act where it stands.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from .car import GRAVITY
from .drive import drive_rates
from .floor import Floor, grip
from .states import NAMES, State
from .steering import road_wheels, steering_rates
from .tyre import bristle_stiffness, tyre_forces


class Chassis:
  """The rates of all states, and what sensors feel. `command` (2, n): voltage [V], steering [rad] as they arrived;
  `draught` (3, n): forces and yaw moment on the body [N, N, N m]. Both may be changed between evaluations."""

  def __init__(self, car: SimpleNamespace, floor: Floor) -> None:
    n = self.n = len(car.mass)
    self.car, self.floor = car, floor
    self.command, self.draught = np.zeros((2, n)), np.zeros((3, n))
    front, rear = np.broadcast_to(car.cg_to_front, (2, n)), np.broadcast_to(-car.cg_to_rear, (2, n))
    self.corner_x = np.concatenate([front, rear])
    half = 0.5 * car.track_width
    self.corner_y = np.stack([half, -half, half, -half]) - car.cg_lateral
    self.rest = rest_loads(car)
    own = np.stack([car.ride_front, car.ride_front, car.ride_rear, car.ride_rear])
    corner = 0.25 * car.sprung
    self.spring, self.damper = corner * own**2, 2.0 * car.ride_damping * corner * own
    self.stiffness = bristle_stiffness(car)
    self.inertia = np.stack([car.roll_inertia, car.pitch_inertia, car.yaw_inertia])
    self.specific_force, self.spin_up = np.zeros((3, n)), np.zeros((3, n))  # m/s^2, rad/s^2, chassis axes

  def rates(self, array: np.ndarray) -> np.ndarray:
    """State (33, n) -> its rates (33, n); leaves `specific_force` and `spin_up` behind."""
    state, rate = State(array), State(np.empty_like(array))
    torque = drive_rates(self.car, state, rate, self.command[0])
    steering_rates(self.car, state, rate, self.command[1])
    self._motion(state, rate, torque)
    return rate.array

  def _motion(self, s: State, k: State, torque: np.ndarray) -> None:
    car = self.car
    tilt = _tilt(s)
    cos, sin = np.cos(s.yaw), np.sin(s.yaw)
    velocity, turning = _turned(tilt, s.u, s.v, s.w), _turned(tilt, s.p, s.q, s.r)
    arm = self._arms(tilt)
    x, y = s.x + cos * arm[0] - sin * arm[1], s.y + sin * arm[0] + cos * arm[1]
    height, slope_x, slope_y = self.floor.at(x, y)
    uphill, aside = cos * slope_x + sin * slope_y, cos * slope_y - sin * slope_x
    drop = s.z + arm[2] - height  # from a corner down to the floor
    moving = [velocity[i] + turn for i, turn in enumerate(_cross(turning, (arm[0], arm[1], -(s.z - height))))]
    rising = velocity[2] + turning[0] * arm[1] - turning[1] * arm[0] - uphill * moving[0] - aside * moving[1]
    load = np.maximum(self.rest + self.spring * (car.cg_height - drop) - self.damper * rising, 1e-3)
    forward, left = self._tyres(s, k, moving, load, torque, grip(car, x, y))
    forward, left = forward - load * uphill, left - load * aside
    down = s.z - height
    force = np.stack([forward.sum(axis=0), left.sum(axis=0), load.sum(axis=0)])
    moment = np.stack(
      [
        (arm[1] * load + down * left).sum(axis=0),
        (-down * forward - arm[0] * load).sum(axis=0) - (car.wheel_inertia * k.wheel).sum(axis=0),
        (arm[0] * left - arm[1] * forward).sum(axis=0) + self.draught[2],
      ]
    )
    drag = car.drag * np.sqrt(velocity[0] ** 2 + velocity[1] ** 2)
    force[0] += self.draught[0] - drag * velocity[0]
    force[1] += self.draught[1] - drag * velocity[1]
    pull = np.stack([cos * car.slope_x + sin * car.slope_y, cos * car.slope_y - sin * car.slope_x])
    self._newton(s, k, _turned_back(tilt, force) / car.mass, _turned_back(tilt, moment),
                 _turned_back(tilt, np.stack([*pull, np.full(self.n, -GRAVITY)])))  # fmt: skip
    k.x[:], k.y[:], k.z[:] = cos * velocity[0] - sin * velocity[1], sin * velocity[0] + cos * velocity[1], velocity[2]

  def _arms(self, tilt: np.ndarray) -> np.ndarray:
    """From the centre of gravity to the corners at its own height (3, 4, n) [m], floor axes."""
    return tilt[:, 0, None] * self.corner_x + tilt[:, 1, None] * self.corner_y

  def _tyres(
    self, s: State, k: State, moving: list[np.ndarray], load: np.ndarray, torque: np.ndarray, grips: np.ndarray
  ) -> tuple[np.ndarray, np.ndarray]:
    """Forces of the floor on the car (4, n) each, forward and to the left; the wheels' and bristles' rates."""
    car, wheel = self.car, s.wheel
    angle = road_wheels(car, s.linkage)
    cos, sin = np.cos(angle), np.sin(angle)
    rolling = car.wheel_radius * wheel
    slide = np.stack([cos * moving[0] + sin * moving[1] - rolling, cos * moving[1] - sin * moving[0]])
    along, across = self._rubber(s, k, slide, rolling, load, grips)
    resisting = car.rolling_resistance * load * car.wheel_radius * wheel / (np.abs(wheel) + 0.5)
    k.wheel[:] = (torque - car.wheel_radius * along - resisting) / car.wheel_inertia
    return cos * along - sin * across, sin * along + cos * across

  def _rubber(
    self, s: State, k: State, slide: np.ndarray, rolling: np.ndarray, load: np.ndarray, grips: np.ndarray
  ) -> np.ndarray:
    """Forces along and across the wheels (2, 4, n) [N]."""
    force, k.bristle[:] = tyre_forces(
      self.car, s.bristle, slide, np.abs(rolling), load, self.stiffness, grips, load / self.rest
    )
    share = load / (self.car.mass * GRAVITY)
    force[1] += self.car.conicity * share * -np.expm1(-np.abs(rolling) / 0.05)
    return force

  def _newton(self, s: State, k: State, felt: np.ndarray, moment: np.ndarray, gravity: np.ndarray) -> None:
    """Accelerations from the specific force (3, n), moments and gravity, all in the chassis' axes."""
    turning, velocity = (s.p, s.q, s.r), (s.u, s.v, s.w)
    self.specific_force = felt
    k.u[:], k.v[:], k.w[:] = (f + g - c for f, g, c in zip(felt, gravity, _cross(turning, velocity), strict=True))
    swept = _cross(turning, tuple(i * w for i, w in zip(self.inertia, turning, strict=True)))
    self.spin_up = (moment - np.stack(swept)) / self.inertia
    k.p[:], k.q[:], k.r[:] = self.spin_up
    sin, cos = np.sin(s.roll), np.cos(s.roll)
    heading = (s.q * sin + s.r * cos) / np.cos(s.pitch)
    k.roll[:], k.pitch[:], k.yaw[:] = s.p + heading * np.sin(s.pitch), s.q * cos - s.r * sin, heading

  def start(self, start: np.ndarray) -> np.ndarray:
    """State (33, n) of cars that roll at start (n, 7): x, y, yaw [m, m, rad], velocity forward and left [m/s], yaw rate
    [rad/s], steering [rad]; upright on their struts, each wheel rolling as its own place moves along it."""
    s = State(np.zeros((len(NAMES), self.n)))
    s.x[:], s.y[:], s.yaw[:], s.u[:], s.v[:], s.r[:], s.servo[:] = start.T
    s.linkage[:] = s.servo
    s.z[:] = self.car.cg_height + self.floor.at(s.x, s.y)[0]
    angle = road_wheels(self.car, s.linkage)
    along, across = s.u - s.r * self.corner_y, s.v + s.r * self.corner_x
    s.wheel[:] = (np.cos(angle) * along + np.sin(angle) * across) / self.car.wheel_radius
    s.motor[:] = 0.25 * s.wheel.sum(axis=0) / self.car.gear_ratio
    s.rub[:] = np.sign(s.motor) * self.car.gear_presliding
    s.current[:] = self.car.gear_ratio * self.car.gear_friction * np.sign(s.motor) / self.car.motor_constant
    return s.array


def rest_loads(car: SimpleNamespace) -> np.ndarray:
  """Loads of the wheels at rest (4, n) [N]: the struts are set so that the car stands level."""
  weight, base = car.mass * GRAVITY, car.cg_to_front + car.cg_to_rear
  left = 0.5 + car.cg_lateral / car.track_width
  front, rear = weight * car.cg_to_rear / base, weight * car.cg_to_front / base
  return np.stack([front * left, front * (1 - left), rear * left, rear * (1 - left)])


def _tilt(s: State) -> np.ndarray:
  """Chassis axes in floor axes (3, 3, n): a turn by the pitch, then by the roll."""
  cr, sr, cp, sp = np.cos(s.roll), np.sin(s.roll), np.cos(s.pitch), np.sin(s.pitch)
  return np.array([[cp, sp * sr, sp * cr], [np.zeros_like(cr), cr, -sr], [-sp, cp * sr, cp * cr]])


def _turned(tilt: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
  """Chassis axes to floor axes (3, n)."""
  return tilt[:, 0] * x + tilt[:, 1] * y + tilt[:, 2] * z


def _turned_back(tilt: np.ndarray, vector: np.ndarray) -> np.ndarray:
  """Floor axes to chassis axes (3, n)."""
  return tilt[0] * vector[0] + tilt[1] * vector[1] + tilt[2] * vector[2]


def _cross(a, b) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
  """a x b of components."""
  return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
