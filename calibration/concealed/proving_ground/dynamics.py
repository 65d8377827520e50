"""Double-track car with body roll and pitch, tyres on a flexible carcass, four wheel spins and two differentials.

Every state is an array over cars (N,); wheels are ordered front left, front right, rear left, rear right. ISO 8855
signs. Tyre: slip through carcass deflection u, u' = v_s - (|V_r| + |v_s|) u / sigma, whose steady state is
u / sigma = v_s / (|V_r| + |v_s|); with q = |C u / sigma| / (mu F_z) the force is C u / sigma times a mix of
tanh(q) / q and the brush's 1 - q/3 + q^2/27 (Pacejka 2012, 3.2).
Dry friction of the motor: Dahl 1968, in the form s' = (w - |w| s) / (z_s + |w| T), torque T_c s.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from .car import GRAVITY, static_loads

STATES = (
    "x", "y", "yaw", "vx", "vy", "yaw_rate", "roll", "pitch", "roll_speed", "pitch_speed",
    "wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr", "motor", "twist_front", "twist_rear",
    "ux_fl", "ux_fr", "ux_rl", "ux_rr", "uy_fl", "uy_fr", "uy_rl", "uy_rr",
    "servo", "servo_speed", "bristle", "motor_angle",
)  # fmt: skip
QUICKEST_BRISTLE = 6e-4  # s, T above
ROW = {name: row for row, name in enumerate(STATES)}


class Frame:
  """Named views of one state array (29, N): rows by name, groups `wheel` (4, N), `twist` (2, N), `carcass` (2, 4, N),
  `tilt` (2, N).
  """

  def __init__(self, array: np.ndarray) -> None:
    self.array = array
    for name, row in ROW.items():
      setattr(self, name, array[row])
    n = array.shape[1]
    self.wheel, self.twist = array[10:14], array[15:17]
    self.left, self.right = array[10:14:2], array[11:14:2]
    self.carcass = array[17:25].reshape(2, 4, n)
    self.tilt, self.tilt_speed = array[6:8], array[8:10]

  def __getattr__(self, name: str) -> np.ndarray:
    raise AttributeError(f"a car has no state '{name}'; there are {', '.join(STATES)}")


class Dynamics:
  """x' = f(x, inputs) for N cars at once. Inputs are public arrays that a step may change: voltage, steer_target, bend,
  wrench, …
  """

  def __init__(self, car: SimpleNamespace) -> None:
    n = len(car.mass)
    self.car, self.n = car, n
    self.state, self.stage, self.rate = (Frame(np.zeros((len(STATES), n))) for _ in range(3))
    self._sum = np.zeros((len(STATES), n))
    self.voltage, self.steer_target, self.bend = np.zeros((3, n))  # V, rad, rad (linkage, added to the servo's angle)
    self.resistance, self.constant, self.conduct = car.motor_resistance.copy(), car.motor_constant.copy(), np.ones(n)
    self.wrench, self.noise_wrench = (
      np.zeros((3, n)),
      np.zeros((3, n)),
    )  # N, N, N m on the body at its centre of gravity
    self.driven: np.ndarray | None = None  # (2, N), 1 where the motor turns the axle, 0 where it rolls free; None: both
    self.regulated: np.ndarray | None = None  # (N,) where electronics keep the current at `demand`; None: nowhere
    self.demand = np.zeros(n)  # A
    self.gravity = np.zeros((2, n))  # m/s^2, world frame, of a floor that is not level
    self.wheel_torque, self.motor_torque = np.zeros((4, n)), np.zeros(n)  # N m, outer ones
    self.unevenness, self.grip = np.ones((4, n)), np.ones((4, n))  # factors on wheel load and on friction
    self.force = np.zeros((2, 4, n))  # N, tyre forces in the wheels' frames, last evaluated
    self.load, self.current, self.acceleration = np.ones((4, n)), np.zeros(n), np.zeros((2, n))
    self.loads: list = []  # hooks(dynamics): add to wrench, wheel_torque, motor_torque
    self.contacts: list = []  # hooks(dynamics): change force
    self._prepare()

  def _prepare(self) -> None:
    """Constants that the car's columns imply."""
    car, n = self.car, self.n
    half = 0.5 * car.track_width
    self.wheel_x = np.stack([car.cg_to_front, car.cg_to_front, -car.cg_to_rear, -car.cg_to_rear])
    self.wheel_y = np.stack([half, -half, half, -half]) - car.cg_lateral
    self.static = static_loads(car)
    mean = np.repeat([[1.0], [1.0]], n, axis=1) * self.static.reshape(2, 2, n).mean(axis=1)
    nominal = np.repeat(mean, 2, axis=0)  # an axle's stiffness is given at the mean load of its wheels
    cornering = np.stack([car.cornering_front, car.cornering_front, car.cornering_rear, car.cornering_rear])
    self.inverse_nominal = 1.0 / nominal
    front = car.relaxation + car.relaxation_front
    self.relaxation = np.stack([front, front, car.relaxation, car.relaxation])
    self.stiffness = np.stack([np.broadcast_to(car.slip_stiffness, (4, n)), cornering]) / self.relaxation
    self.toe_gain = car.ackermann * car.track_width / (2 * (car.cg_to_front + car.cg_to_rear))
    lever = np.stack([car.cg_height, car.cg_height])
    inertia = np.stack([0.45 * car.mass * (car.cg_height**2 + half**2), 0.55 * car.yaw_inertia])
    own = np.stack([car.roll_rate, car.pitch_rate])
    self.tilt_lever = np.stack([lever[0], -lever[1]]) * car.mass / inertia
    self.tilt_stiffness, self.tilt_damping = own**2, 2 * car.body_damping * own
    torque = inertia / np.stack([car.track_width, car.cg_to_front + car.cg_to_rear])
    share = np.stack([car.roll_front, car.roll_front, 1 - car.roll_front, 1 - car.roll_front])
    self.roll_load = torque[0] * share * np.array([[-1.0], [1.0], [-1.0], [1.0]])
    self.pitch_load = torque[1] * 0.5 * np.array([[1.0], [1.0], [-1.0], [-1.0]])
    self.cos, self.sin = np.ones((4, n)), np.zeros((4, n))
    self.steer = np.zeros((2, n))
    self.rate_servo, self.damping_servo = car.servo_rate**2, 2 * car.servo_damping * car.servo_rate
    self.slide = np.zeros((2, 4, n))
    self.has_play = bool(np.any(car.shaft_play))

  def derivative(self) -> None:
    """Fill `rate` from `stage` and the inputs; leaves tyre forces, loads, current and acceleration behind."""
    z, k, car = self.stage, self.rate, self.car
    self._drive_speed = car.wheel_radius * z.wheel
    self._slip(z)
    self._tyre(z, k)
    self.wrench[:] = self.noise_wrench
    self.wheel_torque[:] = 0.0
    self.motor_torque[:] = 0.0
    for hook in self.contacts:
      hook(self)
    for hook in self.loads:
      hook(self)
    self._body(z, k)
    self._drive(z, k)
    k.servo[:] = z.servo_speed
    k.servo_speed[:] = self.rate_servo * (self.steer_target - z.servo) - self.damping_servo * z.servo_speed

  def _slip(self, z: Frame) -> None:
    """Slide velocity of the contact patches (2, 4, N) [m/s], positive where the tyre pushes the car forward or left."""
    angle = z.servo + self.bend
    inner = self.toe_gain * angle * angle
    np.add(angle, inner, out=self.steer[0])
    np.subtract(angle, inner, out=self.steer[1])
    np.cos(self.steer, out=self.cos[:2])
    np.sin(self.steer, out=self.sin[:2])
    along = z.vx - z.yaw_rate * self.wheel_y
    across = z.vy + z.yaw_rate * self.wheel_x
    np.subtract(self._drive_speed, self.cos * along + self.sin * across, out=self.slide[0])
    np.subtract(self.sin * along, self.cos * across, out=self.slide[1])

  def rolling(self) -> np.ndarray:
    """Velocity of the state's contact patches along their wheels (4, N) [m/s], bent linkages aside."""
    self._drive_speed = np.zeros((4, self.n))
    self._slip(self.state)
    return -self.slide[0]

  def _tyre(self, z: Frame, k: Frame) -> None:
    """Wheel loads, carcass rates and brush forces."""
    car, slide = self.car, self.slide
    spring = self.tilt_stiffness * z.tilt + self.tilt_damping * z.tilt_speed
    load = (self.static + self.roll_load * spring[0] + self.pitch_load * spring[1]) * self.unevenness
    self.load = load = np.maximum(load, 1e-3)
    speed = np.sqrt(slide[0] * slide[0] + slide[1] * slide[1])
    np.subtract(slide, z.carcass * ((np.abs(self._drive_speed) + speed) / self.relaxation), out=k.carcass)
    ratio = load * self.inverse_nominal
    less = 1.0 - ratio
    elastic = (self.stiffness * (0.5 + 0.5 * self.grip) * (ratio * (1.0 + car.load_curve * less))) * (
      z.carcass + car.carcass_damping * k.carcass
    )
    peak = car.friction * self.grip * load * (1.0 + car.friction_load * less)
    use = np.clip(np.sqrt(elastic[0] * elastic[0] + elastic[1] * elastic[1]) / peak, 1e-9, 1e3)
    part = np.minimum(use / 3.0, 1.0)
    brush = (1.0 - part + part * part / 3.0) / np.maximum(use / 3.0, 1.0)
    bend = np.tanh(use) / use
    np.multiply(elastic, bend + car.brush_share * (brush - bend), out=self.force)

  def _body(self, z: Frame, k: Frame) -> None:
    """Newton and Euler for the chassis in its own frame, roll and pitch about the ground."""
    car, force = self.car, self.force
    forward = self.cos * force[0] - self.sin * force[1]
    left = self.sin * force[0] + self.cos * force[1]
    cos, sin = np.cos(z.yaw), np.sin(z.yaw)
    a_x = (forward.sum(axis=0) + self.wrench[0]) / car.mass
    a_y = (left.sum(axis=0) + self.wrench[1]) / car.mass
    moment = (self.wheel_x * left - self.wheel_y * forward).sum(axis=0) + self.wrench[2]
    self.acceleration[0], self.acceleration[1] = a_x, a_y  # specific force: gravity of a slope does not show
    g_x = cos * self.gravity[0] + sin * self.gravity[1]
    g_y = cos * self.gravity[1] - sin * self.gravity[0]
    k.vx[:] = a_x + g_x + z.yaw_rate * z.vy
    k.vy[:] = a_y + g_y - z.yaw_rate * z.vx
    k.yaw_rate[:] = moment / car.yaw_inertia
    k.x[:] = cos * z.vx - sin * z.vy
    k.y[:] = sin * z.vx + cos * z.vy
    k.yaw[:] = z.yaw_rate
    k.tilt[:] = z.tilt_speed
    tip = self.tilt_lever * self.acceleration[::-1]
    k.tilt_speed[:] = tip - self.tilt_stiffness * z.tilt - self.tilt_damping * z.tilt_speed

  def _drive(self, z: Frame, k: Frame) -> None:
    """Motor, two elastic axles behind open differentials, four wheels."""
    car = self.car
    k.twist[:] = car.gear_ratio * z.motor - 0.5 * (z.left + z.right)
    if self.has_play:
      wound = z.twist - np.clip(z.twist, -car.shaft_play, car.shaft_play)
      axle = car.shaft_stiffness * wound + car.shaft_damping * k.twist * ((wound != 0.0) | (car.shaft_play == 0.0))
    else:
      axle = car.shaft_stiffness * z.twist + car.shaft_damping * k.twist
    if self.driven is not None:
      axle = axle * self.driven
      k.twist[:] *= self.driven
    self.current = self.conduct * (self.voltage - self.constant * z.motor) / self.resistance
    if self.regulated is not None:
      self.current = np.where(self.regulated, self.demand, self.current)
    turning = np.abs(z.motor)
    k.bristle[:] = (z.motor - turning * z.bristle) / (car.presliding + QUICKEST_BRISTLE * turning)
    own = self.constant * self.current - car.motor_viscous * z.motor - car.motor_coulomb * z.bristle
    k.motor[:] = (own + self.motor_torque - car.gear_ratio * (axle[0] + axle[1])) / car.motor_inertia
    k.motor_angle[:] = z.motor
    rolling = car.rolling_resistance * car.wheel_radius * self.load * z.wheel / np.sqrt(z.wheel * z.wheel + 1.0)
    shared = np.repeat(0.5 * axle, 2, axis=0)
    k.wheel[:] = (shared - car.wheel_radius * self.force[0] - rolling + self.wheel_torque) / car.wheel_inertia

  def step(self, h: float) -> None:
    """One step of the classical fourth-order Runge-Kutta method over h seconds, inputs held."""
    y, z, k, total = self.state.array, self.stage.array, self.rate.array, self._sum
    z[:] = y
    self.derivative()
    np.copyto(total, k)
    for fraction, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
      np.multiply(k, fraction * h, out=z)
      z += y
      self.derivative()
      total += weight * k
    total *= h / 6.0
    y += total


def rolling_start(dynamics: Dynamics, start: np.ndarray) -> None:
  """Put the cars at start (N, 7): x, y, yaw [m, m, rad], velocity_x, velocity_y [m/s], yaw_rate [rad/s], steering_angle
  [rad]. Each wheel rolls as its own place moves along it, so that in a turn the front ones are the faster.
  """
  s, car = dynamics.state, dynamics.car
  s.array[:] = 0.0
  s.x[:], s.y[:], s.yaw[:], s.vx[:], s.vy[:], s.yaw_rate[:], s.servo[:] = start.T
  s.wheel[:] = dynamics.rolling() / car.wheel_radius
  s.motor[:] = s.wheel.mean(axis=0) / car.gear_ratio
  s.bristle[:] = np.tanh(s.motor / 5.0)
  dynamics.steer_target[:] = s.servo


def weight(dynamics: Dynamics) -> np.ndarray:
  """Weight of the cars (N,) [N]."""
  return dynamics.car.mass * GRAVITY
