"""Geometry of planar motion: angles, frames, slip, steering, steady turning.

Pure functions that broadcast over any leading shape. Signs are ISO 8855: x forward, y left, angles
and yaw rate counter-clockwise positive. Lengths are in m, angles in rad, speeds in m/s, rates in
rad/s, accelerations in m/s^2. A position (x, y) on the car is measured from its centre of gravity.

Source of the steady-turning formulas: Rajamani, Vehicle Dynamics and Control, 2nd ed. (2012), ch. 3.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Quantity = Array | float  # anything that broadcasts


# -- angles and frames ---------------------------------------------------------------------------


def wrap_angle(angle: Quantity) -> Array:
  """The same direction in (-pi, pi]."""
  angle = np.asarray(angle, dtype=np.float64)
  return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def body_to_world(yaw: Quantity, x: Quantity, y: Quantity) -> tuple[Array, Array]:
  """Rotate a vector from the body frame into the world frame: R(yaw) (x, y)."""
  cos, sin = np.cos(yaw), np.sin(yaw)
  return cos * x - sin * y, sin * x + cos * y


# -- from the motor to the road ------------------------------------------------------------------


class Geared(Protocol):
  """A car whose motor turns its wheels."""

  @property
  def gear_ratio(self) -> float: ...  # G, wheel speed / motor speed
  @property
  def wheel_radius(self) -> float: ...  # R_w, rolling radius, m


def rolling_radius(car: Geared) -> float:
  """Travel per radian that the motor turns, G R_w [m/rad]."""
  return car.gear_ratio * car.wheel_radius


def road_speed(motor_speed: Quantity, car: Geared) -> Array:
  """Speed of a car whose wheels don't slip: v = omega G R_w [m/s], from the motor's omega [rad/s], both signed."""
  return np.asarray(motor_speed, dtype=np.float64) * car.gear_ratio * car.wheel_radius


def motor_speed(road_speed: Quantity, car: Geared) -> Array:
  """Motor speed of a car whose wheels don't slip: omega = v / (G R_w) [rad/s], from v [m/s], both signed."""
  return np.asarray(road_speed, dtype=np.float64) / rolling_radius(car)


# -- acceleration of a point on the car ----------------------------------------------------------


def transport_acceleration(
  accel_x: Quantity,
  accel_y: Quantity,
  yaw_rate: Quantity,
  yaw_acceleration: Quantity,
  x: Quantity,
  y: Quantity,
) -> tuple[Array, Array]:
  """Body-frame acceleration of the point (x, y), as an IMU mounted there feels it on level ground.

  a_x - r' y - r^2 x,  a_y + r' x - r^2 y, with r' the yaw acceleration [rad/s^2] and a_x, a_y the
  acceleration of the centre of gravity [m/s^2].
  """
  spin = np.square(yaw_rate)
  yaw_acceleration = np.asarray(yaw_acceleration, dtype=np.float64)
  return (
    accel_x - yaw_acceleration * y - spin * x,
    accel_y + yaw_acceleration * x - spin * y,
  )


# -- slip ----------------------------------------------------------------------------------------


def sideslip_angle(velocity_x: Quantity, velocity_y: Quantity) -> Array:
  """Sideslip angle beta of the vehicle [rad]: v_x = v cos beta, v_y = v sin beta, v signed like v_x.

  It stays near zero in reverse, and is zero at standstill.
  """
  velocity_x = np.asarray(velocity_x, dtype=np.float64)
  return np.arctan2(velocity_y * np.where(velocity_x < 0.0, -1.0, 1.0), np.abs(velocity_x))


def kinematic_sideslip_angle(steering_angle: Quantity, cg_to_front: Quantity, cg_to_rear: Quantity) -> Array:
  """Sideslip of a car whose tyres don't slip: beta = atan(L_r / (L_f + L_r) tan delta) [rad].

  The paper prints axle stiffnesses in place of the lengths and leaves tan delta outside the atan.
  """
  share = np.asarray(cg_to_rear) / (np.asarray(cg_to_front) + cg_to_rear)
  return np.arctan(share * np.tan(steering_angle))


def kinematic_yaw_rate(speed: Quantity, steering_angle: Quantity, cg_to_front: Quantity, cg_to_rear: Quantity) -> Array:
  """Yaw rate of a car whose tyres don't slip: r = v cos(beta) tan(delta) / (L_f + L_r) [rad/s].

  `speed` is that of the centre of gravity, signed.
  """
  sideslip = kinematic_sideslip_angle(steering_angle, cg_to_front, cg_to_rear)
  wheelbase = np.asarray(cg_to_front) + cg_to_rear
  return speed * np.cos(sideslip) * np.tan(steering_angle) / wheelbase


# -- steady turning ------------------------------------------------------------------------------


def understeer_gradient(
  mass: Quantity,
  cg_to_front: Quantity,
  cg_to_rear: Quantity,
  cornering_stiffness_front: Quantity,
  cornering_stiffness_rear: Quantity,
) -> Array:
  """Understeer gradient K [rad s^2/m]: delta = L / R + K a_y in steady turning.

  K = m / L (L_r / C_f - L_f / C_r), stiffnesses per axle in N/rad; positive understeers.
  """
  wheelbase = np.asarray(cg_to_front) + cg_to_rear
  front = cg_to_rear / np.asarray(cornering_stiffness_front)
  rear = cg_to_front / np.asarray(cornering_stiffness_rear)
  return np.asarray(mass) / wheelbase * (front - rear)


def steering_per_lateral_acceleration(speed: Quantity, wheelbase: Quantity, gradient: Quantity) -> Array:
  """Exact k_su = delta / a_ys of the linear single track, (L + K v^2) / v^2 [rad s^2/m]."""
  squared = np.square(speed)
  return (wheelbase + np.asarray(gradient) * squared) / squared


def steering_per_lateral_acceleration_as_printed(
  speed: Quantity,
  cg_to_front: Quantity,
  cg_to_rear: Quantity,
  cornering_stiffness_front: Quantity,
  cornering_stiffness_rear: Quantity,
) -> Array:
  """The paper's k_su = (C_f L_f^2 + C_r L_r^2) / (C_f L_f v^2) [rad s^2/m].

  It leaves sideslip out of the yaw equation. So it equals the exact one where that term vanishes:
  if C_f L_f = C_r L_r, or at the one speed where the steady sideslip is zero.
  """
  front = np.asarray(cornering_stiffness_front) * cg_to_front
  rear = np.asarray(cornering_stiffness_rear) * cg_to_rear
  return (front * cg_to_front + rear * cg_to_rear) / (front * np.square(speed))


def yaw_rate_gain(speed: Quantity, wheelbase: Quantity, gradient: Quantity) -> Array:
  """Steady yaw rate per steering angle: r / delta = v / (L + K v^2) [1/s]."""
  return speed / (wheelbase + np.asarray(gradient) * np.square(speed))


def sideslip_gain(
  speed: Quantity,
  mass: Quantity,
  cg_to_front: Quantity,
  cg_to_rear: Quantity,
  cornering_stiffness_rear: Quantity,
  gradient: Quantity,
) -> Array:
  """Steady sideslip per steering angle [-]: (L_r - m L_f v^2 / (C_r L)) / (L + K v^2)."""
  wheelbase = np.asarray(cg_to_front) + cg_to_rear
  squared = np.square(speed)
  slip = np.asarray(mass) * cg_to_front * squared / (np.asarray(cornering_stiffness_rear) * wheelbase)
  return (cg_to_rear - slip) / (wheelbase + np.asarray(gradient) * squared)
