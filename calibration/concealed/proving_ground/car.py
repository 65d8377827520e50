"""The numbers of an independent 1:10 car, drawn from a seed, and what a scale and a ruler would say of it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from types import SimpleNamespace

import numpy as np

from .drivetrain import Drivetrain

GRAVITY = 9.81  # m/s^2
GEAR_RATIO = (13 * 19) / (70 * 37)  # wheel speed / motor speed of the QCar's gears


@dataclass(frozen=True)
class Car:
  """One car. SI units, per-wheel stiffnesses, motor-side drive numbers."""

  mass: float = 2.7  # kg
  yaw_inertia: float = 0.030  # kg m^2
  cg_to_front: float = 0.128  # m
  cg_to_rear: float = 0.128  # m
  track_width: float = 0.170  # m
  cg_height: float = 0.045  # m
  cg_lateral: float = 0.0  # m, centre of gravity left of the centre line
  wheel_radius: float = 0.033  # m
  wheel_inertia: float = 5.0e-5  # kg m^2 each, with hub and half shaft
  gear_ratio: float = GEAR_RATIO
  max_steering: float = 0.5236  # rad
  ackermann: float = 0.7  # share of the exact Ackermann difference
  servo_rate: float = 300.0  # rad/s, natural frequency of the servo's position loop
  servo_damping: float = 0.75
  motor_constant: float = 2.9e-3  # N m/A and V s/rad
  motor_resistance: float = 0.16  # ohm, cold
  motor_inertia: float = 3.0e-6  # kg m^2
  motor_viscous: float = 1.0e-6  # N m s/rad
  motor_coulomb: float = 2.5e-3  # N m
  presliding: float = 0.1  # rad of motor angle over which dry friction builds up
  shaft_stiffness: float = 30.0  # N m/rad, each axle
  shaft_damping: float = 0.015  # N m s/rad
  shaft_play: float = 0.0  # rad, half of the play, axle side
  cornering_front: float = 72.0  # N/rad per wheel at its static load
  cornering_rear: float = 78.0
  slip_stiffness: float = 150.0  # N per unit slip, per wheel at its static load
  load_curve: float = 0.10  # stiffness = linear * q * (1 + load_curve * (1 - q)), q = load / static load
  friction: float = 0.90
  brush_share: float = 0.1  # of the brush model's bend in the tyre law, the rest is a hyperbolic tangent
  friction_load: float = 0.05  # friction falls by this per unit of q
  relaxation: float = 0.010  # m, transient slip of the carcass
  relaxation_front: float = 0.0  # m, on top of it at the front tyres
  carcass_damping: float = 1.5e-3  # s
  rolling_resistance: float = 0.014
  roll_rate: float = 70.0  # rad/s, natural frequency of body roll
  pitch_rate: float = 80.0
  body_damping: float = 0.5
  roll_front: float = 0.5  # share of the roll stiffness at the front axle
  imu_x: float = 0.02  # m from the centre of gravity
  imu_y: float = 0.005
  marker_x: float = 0.0  # m, pose reference point from the centre of gravity
  marker_y: float = 0.0
  heat_capacity: float = 120.0  # J/K
  heat_resistance: float = 8.0  # K/W
  copper: float = 0.0020  # 1/K, rise of the armature resistance (copper and brushes together)
  charge: float = 9000.0  # C, usable charge of the pack
  discharge: float = 0.01  # share of the voltage lost over the whole charge
  drivetrain: Drivetrain = Drivetrain()

  @classmethod
  def draw(cls, rng: np.random.Generator) -> Car:
    """A car of the QCar's kind: 2 to 3.3 kg, other geometry, tyres and motor."""
    mass, wheelbase = rng.uniform(2.0, 3.3), rng.uniform(0.240, 0.275)
    front = wheelbase * rng.uniform(0.45, 0.54)
    rear = wheelbase - front
    load_front, load_rear = (0.5 * mass * GRAVITY * arm / wheelbase for arm in (rear, front))
    grip_front = rng.uniform(9.0, 13.0)
    grip_rear = grip_front * rng.uniform(1.0, 1.25)
    return cls(
            mass=mass, cg_to_front=front, cg_to_rear=rear, yaw_inertia=mass * front * rear * rng.uniform(0.62, 0.85),
            track_width=rng.uniform(0.160, 0.185), cg_height=rng.uniform(0.036, 0.054),
            wheel_radius=rng.uniform(0.031, 0.036),
            wheel_inertia=rng.uniform(4e-5, 7e-5), ackermann=rng.uniform(0.4, 1.0),
            servo_rate=rng.uniform(270.0, 340.0),
            motor_constant=rng.uniform(2.6e-3, 3.2e-3), motor_resistance=rng.uniform(0.13, 0.19),
            motor_inertia=rng.uniform(2e-6, 4e-6), motor_viscous=rng.uniform(0.5e-6, 1.5e-6),
            motor_coulomb=rng.uniform(1.5e-3, 3.5e-3),
            cornering_front=grip_front * load_front, cornering_rear=grip_rear * load_rear,
            slip_stiffness=rng.uniform(20.0, 30.0) * mass * GRAVITY / 4, friction=rng.uniform(0.78, 1.05),
      brush_share=rng.uniform(0.0, 0.2),
            relaxation=rng.uniform(0.008, 0.013), rolling_resistance=rng.uniform(0.010, 0.018),
            roll_front=rng.uniform(0.42, 0.58),
            imu_x=rng.uniform(-0.03, 0.04), imu_y=rng.uniform(-0.015, 0.015),
        )  # fmt: skip

  @classmethod
  def draw_f1tenth(cls, rng: np.random.Generator, layout: str, command: str) -> Car:
    """A car of the F1TENTH kind: O'Kelly et al., F1TENTH: An Open-source Evaluation Environment, NeurIPS 2019 (mass,
    lengths, inertia of its simulator's car), a brushless motor of 3500 rpm/V behind a VESC, lead about 12 to 1.

    The VESC's speed loop brings the car to its speed in a tenth of a second and believes in a wheel a few per cent off.
    """
    mass, front, rear = rng.uniform(3.2, 3.9), rng.uniform(0.155, 0.163), rng.uniform(0.168, 0.175)
    load_front, load_rear = (0.5 * mass * GRAVITY * arm / (front + rear) for arm in (rear, front))
    grip_front = rng.uniform(9.0, 12.0)
    car = cls(
      mass=mass, cg_to_front=front, cg_to_rear=rear, yaw_inertia=mass * front * rear * rng.uniform(0.5, 0.65),
      track_width=rng.uniform(0.23, 0.25), cg_height=rng.uniform(0.060, 0.075), wheel_radius=rng.uniform(0.049, 0.053),
      wheel_inertia=rng.uniform(1.6e-4, 2.2e-4), gear_ratio=1 / rng.uniform(11.5, 12.5), max_steering=0.4189,
      ackermann=rng.uniform(0.4, 0.9), servo_rate=rng.uniform(120.0, 180.0),
      motor_constant=60 / (2 * np.pi * 3500) * rng.uniform(0.95, 1.05), motor_resistance=rng.uniform(0.05, 0.08),
      motor_inertia=rng.uniform(4e-6, 7e-6), motor_viscous=rng.uniform(2e-6, 4e-6),
      motor_coulomb=rng.uniform(2e-3, 4e-3),
      cornering_front=grip_front * load_front, cornering_rear=grip_front * rng.uniform(1.0, 1.2) * load_rear,
      slip_stiffness=rng.uniform(20.0, 30.0) * mass * GRAVITY / 4, friction=rng.uniform(0.8, 1.0),
      relaxation=rng.uniform(0.010, 0.016), rolling_resistance=rng.uniform(0.012, 0.018),
      roll_rate=rng.uniform(50.0, 60.0), pitch_rate=rng.uniform(55.0, 65.0),
      imu_x=rng.uniform(-0.03, 0.05), imu_y=rng.uniform(-0.01, 0.01),
    )  # fmt: skip
    proportional = car.inertia / (0.1 * car.motor_constant)
    travel = car.gear_ratio * car.wheel_radius * rng.uniform(0.96, 1.04)
    limit = rng.uniform(0.35, 0.45) * GRAVITY * car.inertia / (car.motor_constant * car.gear_ratio * car.wheel_radius)
    train = Drivetrain(layout, command, 11.1, limit, proportional, proportional / 0.6, 1 / travel)
    return replace(car, drivetrain=train)

  @property
  def servo_time_constant(self) -> float:
    """Lag of the servo at low frequencies [s]."""
    return 2.0 * self.servo_damping / self.servo_rate

  @property
  def wheelbase(self) -> float:
    """Distance of the axles [m]."""
    return self.cg_to_front + self.cg_to_rear

  @property
  def inertia(self) -> float:
    """All that turns or moves with the motor, seen from the motor [kg m^2]."""
    moved = 4 * self.wheel_inertia + self.mass * self.wheel_radius**2
    return self.motor_inertia + self.gear_ratio**2 * moved

  def linearised(self) -> dict[str, float]:
    """P1, P2, P3 of w' = P1 u - P2 w - P3 sgn w (motor, cold, straight) and the axles' cornering stiffness.

    u is the drive command; a limit of the current and the memory of a speed loop are left out.
    """
    resistance_torque = self.gear_ratio * self.wheel_radius * self.rolling_resistance * self.mass * GRAVITY
    back_emf = self.motor_constant**2 / self.motor_resistance
    train, loop = self.drivetrain, self.motor_constant * self.drivetrain.proportional
    gain, damping = {
      "voltage": (self.motor_constant / (self.inertia * self.motor_resistance), back_emf),
      "duty": (self.motor_constant * train.supply / (self.inertia * self.motor_resistance), back_emf),
      "current": (self.motor_constant / self.inertia, 0.0),
      "speed": (loop * train.motor_per_speed / self.inertia, loop),
    }[train.command]
    return {
      "P1": gain,  # rad/s^2/V, or per unit of another command
      "P2": (damping + self.motor_viscous) / self.inertia,  # 1/s
      "P3": (self.motor_coulomb + resistance_torque) / self.inertia,  # rad/s^2
      "cornering_stiffness_front": 2 * self.cornering_front,  # N/rad
      "cornering_stiffness_rear": 2 * self.cornering_rear,
    }

  def measured(self, rng: np.random.Generator) -> tuple[dict[str, float | str], dict[str, float]]:
    """The [vehicle] table as measured, and its standard deviations; a normal error is cut at two of them."""
    exact: dict[str, float | str] = {"gear_ratio": self.gear_ratio, "max_steering": self.max_steering}
    exact |= self.drivetrain.described()
    std = {
            "mass": 0.01, "yaw_inertia": 0.06 * self.yaw_inertia, "cg_to_front": 0.002, "cg_to_rear": 0.002,
            "track_width": 0.001, "cg_height": 0.004, "wheel_radius": 1.5e-4, "imu_x": 0.003, "imu_y": 0.003,
            "motor_constant": 0.015 * self.motor_constant, "motor_resistance": 0.04 * self.motor_resistance,
            "servo_time_constant": 0.0015,  # road wheels filmed at some hundred frames a second
        }  # fmt: skip
    error = np.clip(rng.standard_normal(len(std)), -2, 2)
    value = {name: getattr(self, name) + std[name] * e for (name, e) in zip(std, error, strict=True)}
    value["cg_to_rear"] = self.wheelbase + 5e-4 * error[3] - value["cg_to_front"]  # the wheelbase is read off a ruler
    return value | exact, std


def armature(car: Car, command: np.ndarray, motor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
  """Current [A] and voltage [V] of the cold motor at a speed [rad/s] under a drive command, for a reckoning of heat."""
  train = car.drivetrain
  if train.command in ("voltage", "duty"):
    volts = command if train.command == "voltage" else command * train.supply
    return (volts - car.motor_constant * motor) / car.motor_resistance, volts
  wish = command if train.command == "current" else train.proportional * (train.motor_per_speed * command - motor)
  current = np.clip(wish, -train.max_current, train.max_current)
  return current, car.motor_constant * motor + car.motor_resistance * current


NUMBERS = tuple(f.name for f in fields(Car) if f.name != "drivetrain")


def fleet(cars: list[Car], counts: list[int]) -> SimpleNamespace:
  """The cars' numbers as columns: attribute -> array (N,), car i repeated counts[i] times; drivetrains as a list."""
  trains = [car.drivetrain for car, count in zip(cars, counts, strict=True) for _ in range(count)]
  columns = {name: np.repeat([getattr(car, name) for car in cars], counts) for name in NUMBERS}
  return SimpleNamespace(**columns, drivetrain=trains)


def static_loads(car: SimpleNamespace) -> np.ndarray:
  """Wheel loads at rest (4, N) [N]: front left, front right, rear left, rear right."""
  wheelbase = car.cg_to_front + car.cg_to_rear
  weight = car.mass * GRAVITY
  left = 0.5 + car.cg_lateral / car.track_width
  front, rear = weight * car.cg_to_rear / wheelbase, weight * car.cg_to_front / wheelbase
  return np.stack([front * left, front * (1 - left), rear * left, rear * (1 - left)])


def describe(car: Car) -> dict[str, float | str]:
  """The car's own numbers for the truth file."""
  return {name: float(getattr(car, name)) for name in NUMBERS} | car.drivetrain.described()


def one_of(columns: SimpleNamespace, index: int) -> Car:
  """The car of one column, with whatever effects did to it."""
  numbers = {name: float(getattr(columns, name)[index]) for name in NUMBERS}
  return Car(**numbers, drivetrain=columns.drivetrain[index])
