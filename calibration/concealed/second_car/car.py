"""The numbers of the second car, drawn from a seed within published or plausible ranges; null values of its effects.

SI units, ISO 8855 axes (x forward, y left, z up), wheels in the order front left, front right, rear left, rear right.
Lengths, gears and encoder: Quanser, QCar User Manual. Bristle friction: Canudas de Wit and Tsiotras, CDC 1999.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

GRAVITY = 9.81  # m/s^2
NOMINAL_PACK = 11.1  # V, three lithium cells; the bridge makes the voltage asked for as a share of it


@dataclass
class SecondCar:
  """One car. Numbers with a null value of zero (or one) at the end belong to the concealed effects."""

  mass: float = 2.65  # kg
  roll_inertia: float = 0.010  # kg m^2
  pitch_inertia: float = 0.026
  yaw_inertia: float = 0.031
  cg_to_front: float = 0.127  # m
  cg_to_rear: float = 0.130
  track_width: float = 0.172
  cg_height: float = 0.046
  wheel_radius: float = 0.033
  wheel_inertia: float = 5.5e-5  # kg m^2, with hub and half shaft
  ride_front: float = 34.0  # rad/s, of a corner on its spring
  ride_rear: float = 34.0
  ride_damping: float = 0.4  # of critical
  max_steering: float = 0.5236  # rad
  ackermann: float = 0.8  # share of the exact trapezium
  servo_time: float = 6e-3  # s
  servo_speed: float = 13.0  # rad/s, its limit
  gear_ratio: float = (13 * 19) / (70 * 37)  # wheel speed / motor speed
  motor_constant: float = 2.9e-3  # N m/A and V s/rad
  motor_resistance: float = 0.155  # ohm, at the room's temperature
  motor_inductance: float = 1.7e-4  # H
  motor_inertia: float = 3e-6  # kg m^2
  motor_viscous: float = 1e-6  # N m s/rad
  winding_warmth: float = 6.0  # K, most that a session brings
  gear_friction: float = 0.026  # N m at the gears' output
  gear_presliding: float = 0.09  # rad, there
  shaft_stiffness: float = 25.0  # N m/rad of all shafts in series, at the wheels
  shaft_damping: float = 0.02  # N m s/rad
  grease_axle: float = 1.5e-4  # N m s/rad, between left and right
  grease_centre: float = 3e-4  # between front and rear
  cornering_front: float = 10.0  # 1/rad, stiffness over load
  cornering_rear: float = 11.0
  slip_stiffness: float = 15.0  # per unit of slip, over load
  patch_length: float = 0.020  # m
  static_friction: float = 0.95
  kinetic_share: float = 0.9  # of the static friction, at high sliding speed
  stribeck_speed: float = 3.0  # m/s
  load_fall: float = 0.06  # friction and stiffness over load go with (F_z / F_z0)^-load_fall
  bristle_damping: float = 2.0  # s/m
  rolling_resistance: float = 0.013
  drag: float = 0.016  # kg/m: half of air density, 0.9, 0.03 m^2
  pack_resistance: float = 0.02  # ohm, at once
  pack_slow_resistance: float = 0.01  # ohm, after pack_time
  pack_time: float = 2.0  # s
  imu_x: float = 0.02  # m from the centre of gravity
  imu_y: float = 0.0
  cg_lateral: float = 0.0  # m, centre of gravity left of the centre line
  marker_x: float = 0.0  # m, tracked point from the centre of gravity
  marker_y: float = 0.0
  steering_delay: float = 0.0  # s
  drive_delay: float = 0.0
  drive_time: float = 0.0  # s, smoothing of the bridge's reference
  drive_zone: float = 0.0  # V
  drive_backward: float = 1.0  # gain of negative voltages
  steering_zone: float = 0.0  # rad
  steering_trim: float = 0.0
  steering_gain: float = 1.0
  steering_play: float = 0.0  # rad, the whole of it
  relaxation_front: float = 0.0  # m, on top of half the patch, at the front tyres
  breakaway: float = 0.0  # N m at the gears' output, on top of gear_friction
  breakaway_speed: float = 4.0  # rad/s there
  clutch: float = 0.0  # N m, preload between left and right of either axle
  conicity: float = 0.0  # N, of the whole car
  slope_x: float = 0.0  # m/s^2 along the room's axes
  slope_y: float = 0.0
  patch_loss: float = 0.0  # share of friction
  patch_x: float = 0.0  # m
  patch_y: float = 0.0
  patch_radius: float = 1.0
  gyro_gain: float = 0.0
  imu_twist: float = 0.0  # rad
  imu_delay: float = 0.0  # s

  @classmethod
  def draw(cls, rng: np.random.Generator) -> SecondCar:
    """A car of the QCar's kind, every number uniform within its range."""
    mass, wheelbase, track = rng.uniform(2.3, 3.0), rng.uniform(0.245, 0.270), rng.uniform(0.162, 0.182)
    front, height = wheelbase * rng.uniform(0.46, 0.53), rng.uniform(0.038, 0.052)
    grip = rng.uniform(8.5, 12.0)
    return cls(
      mass=mass, cg_to_front=front, cg_to_rear=wheelbase - front, track_width=track, cg_height=height,
      roll_inertia=mass * (0.28 * track) ** 2 * rng.uniform(0.9, 1.3),
      pitch_inertia=mass * front * (wheelbase - front) * rng.uniform(0.55, 0.75),
      yaw_inertia=mass * front * (wheelbase - front) * rng.uniform(0.64, 0.86),
      wheel_radius=rng.uniform(0.0315, 0.0350), wheel_inertia=rng.uniform(4.5e-5, 7e-5),
      ride_front=2 * np.pi * rng.uniform(4.5, 7.0), ride_rear=2 * np.pi * rng.uniform(4.5, 7.0),
      ride_damping=rng.uniform(0.3, 0.6), ackermann=rng.uniform(0.5, 1.0),
      servo_time=rng.uniform(4e-3, 8e-3), servo_speed=rng.uniform(10.0, 17.0),
      motor_constant=rng.uniform(2.65e-3, 3.15e-3), motor_resistance=rng.uniform(0.135, 0.180),
      motor_inductance=rng.uniform(1.2e-4, 2.2e-4), motor_inertia=rng.uniform(2.2e-6, 3.8e-6),
      motor_viscous=rng.uniform(0.5e-6, 1.5e-6), winding_warmth=rng.uniform(3.0, 8.0),
      gear_friction=rng.uniform(0.018, 0.034), shaft_stiffness=rng.uniform(18.0, 35.0),
      grease_axle=rng.uniform(0.5e-4, 2.5e-4), grease_centre=rng.uniform(1e-4, 5e-4),
      cornering_front=grip, cornering_rear=grip * rng.uniform(1.0, 1.2), slip_stiffness=rng.uniform(13.0, 20.0),
      patch_length=rng.uniform(0.015, 0.024), static_friction=rng.uniform(0.85, 1.05),
      kinetic_share=rng.uniform(0.85, 0.95), stribeck_speed=rng.uniform(2.0, 4.0), load_fall=rng.uniform(0.0, 0.12),
      rolling_resistance=rng.uniform(0.010, 0.017), imu_x=rng.uniform(-0.03, 0.04), imu_y=rng.uniform(-0.012, 0.012),
    )  # fmt: skip

  @property
  def servo_time_constant(self) -> float:
    """Lag of the servo at low frequencies [s]."""
    return self.servo_time

  @property
  def wheelbase(self) -> float:
    """Distance of the axles [m]."""
    return self.cg_to_front + self.cg_to_rear

  def drive_line(self) -> tuple[float, float]:
    """Voltage per motor speed [V s/rad] and voltage that just keeps the car moving [V], straight on a level floor."""
    viscous = self.motor_resistance * self.motor_viscous / self.motor_constant
    rolling = self.rolling_resistance * self.mass * GRAVITY * self.wheel_radius
    friction = self.gear_ratio * (self.gear_friction + rolling)
    return self.motor_constant + viscous, self.motor_resistance / self.motor_constant * friction

  def measured(self, rng: np.random.Generator) -> tuple[dict[str, float | str], dict[str, float]]:
    """The [vehicle] table as read off a scale, a ruler and a data sheet, and its standard deviations."""
    std = {
      "mass": 0.008, "yaw_inertia": 0.07 * self.yaw_inertia, "cg_to_front": 0.0015, "cg_to_rear": 0.0015,
      "track_width": 0.001, "cg_height": 0.004, "wheel_radius": 1.5e-4, "imu_x": 0.002, "imu_y": 0.002,
      "motor_constant": 0.02 * self.motor_constant, "motor_resistance": 0.04 * self.motor_resistance,
      "servo_time_constant": 0.0015,  # road wheels filmed at some hundred frames a second
    }  # fmt: skip
    off = {name: np.clip(rng.standard_normal(), -2.0, 2.0) for name in std}
    off["cg_to_rear"] = -off["cg_to_front"]  # the wheelbase itself is read to a tenth of a millimetre
    value = {name: getattr(self, name) + std[name] * off[name] for name in std}
    return value | {"gear_ratio": self.gear_ratio, "max_steering": self.max_steering}, std

  def described(self) -> dict[str, float]:
    """Every number, for the truth."""
    return {f.name: float(getattr(self, f.name)) for f in fields(self)}
