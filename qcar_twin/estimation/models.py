"""Motion models of the two local filters, discretised at the control period, with their Jacobians.

The equations are those of `qcar_twin.bicycle.single_track`; here they are stepped cheaply enough for a filter
(one car in microseconds) and with the transition's exact Jacobian. Written once for single cars and for
many: states are tuples of floats, or of arrays (N,), and `lib` is `math` or `numpy` accordingly.
Units m, s, rad, V; axes ISO 8855, steering and yaw positive to the left.
"""

import math
from types import ModuleType
from typing import Any

from qcar_twin.bicycle.single_track import SingleTrackCar

STANDSTILL = 0.02  # m/s, below which |v| in the lateral model is smoothed: sqrt(v^2 + STANDSTILL^2)
X, Y, V, YAW, BETA, R = range(6)

State = tuple[Any, ...]  # one float, or one array (N,), per state


def speed_step(v: Any, voltage: Any, car: SingleTrackCar, period: float, lib: ModuleType = math) -> tuple[Any, Any]:
  """Speed after a period of dv/dt = G R_w (P1 V - P3 sgn v) - P2 v, m/s, and its derivative by v.

  Euler, with Coulomb friction as the limit it is: it takes at most h G R_w P3 off the speed and never turns
  it round, so a car at rest stays at rest. The paper's eq. (EKF_bm_v) divides by the wheel radius where it
  must multiply.
  """
  free = v + period * (car.rolling_radius * car.drive_gain * voltage - car.drive_damping * v)
  drag = period * car.rolling_radius * car.drive_friction
  after = free + 0.5 * (abs(free - drag) - abs(free + drag))
  slides = 1.0 + 0.5 * (lib.copysign(1.0, free - drag) - lib.copysign(1.0, free + drag))
  return after, slides * (1.0 - period * car.drive_damping)


def bicycle_step(
  state: State, voltage: Any, steering: Any, car: SingleTrackCar, period: float, lib: ModuleType = math
) -> tuple[State, State]:
  """EKF_BM's prediction over one period and the Jacobian entries that are neither 0 nor 1.

  Speed by Euler, yaw and position by the midpoint; sideslip and yaw rate by backward Euler: their
  time constants (m v / C) are shorter than the period at low speed. Divisions by v are multiplied out, so
  that v -> 0 tends to the kinematic car (beta = L_r delta / L, r = v delta / L) without a switch. Reverse is v < 0 with
  the same meaning of beta, v_y = v beta.

  Args:
    state: X, Y, v, psi, beta, r, each a float or (N,).
    voltage, steering: held over the period, V and rad.

  Returns:
    The next state, and (XV, Xpsi, Xr, YV, Ypsi, Yr, VV, BV, BB, BR, RV, RB, RR); dX/dbeta equals dX/dpsi.
  """
  x, y, v, yaw, beta, r = state
  h = period
  v_next, v_v = speed_step(v, voltage, car, h, lib)
  rate, rate_v = (v_next - v) / h, (v_v - 1.0) / h
  (beta_next, r_next), lateral = lateral_step((v, beta, r), (rate, rate_v), steering, car, h, lib)
  course = yaw + beta + 0.5 * h * r
  cos, sin = lib.cos(course), lib.sin(course)
  following = (x + h * v * cos, y + h * v * sin, v_next, yaw + h * r, beta_next, r_next)
  along_x = (h * cos, -h * v * sin, -0.5 * h * h * v * sin)
  along_y = (h * sin, h * v * cos, 0.5 * h * h * v * cos)
  return following, (*along_x, *along_y, v_v, *lateral)


def lateral_step(
  state: State, acceleration: State, steering: Any, car: SingleTrackCar, period: float, lib: ModuleType = math
) -> tuple[State, State]:
  """Sideslip and yaw rate after a period (backward Euler) and their derivatives by v, beta, r.

  With a = |v|, s = sgn v, C = C_f + C_r, c1 = C_f L_f - C_r L_r, c2 = C_f L_f^2 + C_r L_r^2 it solves
    (m a + h (C + m s v')) beta+ + h (c1 + m a v) (r+ / v) = m a beta + h C_f delta
    (I a + h c2) r+ + h c1 v beta+ = I a r + h v C_f L_f delta
  for (beta+, r+): the equations of `single_track` times m |v| and I |v|.

  Args:
    state: v, beta, r.
    acceleration: v' and its derivative by v.
  """
  v, beta, r = state
  rate, rate_v = acceleration
  m, inertia, h = car.mass, car.yaw_inertia, period
  front, rear = car.cornering_stiffness_front, car.cornering_stiffness_rear
  c1 = front * car.cg_to_front - rear * car.cg_to_rear
  c2 = front * car.cg_to_front**2 + rear * car.cg_to_rear**2
  push, twist = h * front * steering, h * front * car.cg_to_front * steering

  a = lib.sqrt(v * v + STANDSTILL * STANDSTILL)  # |v|
  s = v / a  # sgn v
  s_v = (1.0 - s * s) / a
  e, e_v = inertia * a + h * c2, inertia * s
  g, g_v = h * (c1 + m * a * v), h * m * (s * v + a)  # coupling of r into beta
  spin = inertia * s * r + twist
  top = m * a * beta + push - g * spin / e
  bottom = m * a + h * (front + rear + m * s * rate) - h * c1 * g / e
  beta_next = top / bottom
  top_v = m * s * beta - (g_v * spin + g * inertia * s_v * r) / e + g * spin * e_v / (e * e)
  bottom_v = m * s + h * m * (s_v * rate + s * rate_v) - h * c1 * (g_v / e - g * e_v / (e * e))
  beta_v = (top_v - beta_next * bottom_v) / bottom
  beta_beta = m * a / bottom
  beta_r = -g * inertia * s / (e * bottom)

  r_next = (inertia * a * r + v * (twist - h * c1 * beta_next)) / e
  pull = h * c1 * v / e
  r_v = (spin - h * c1 * beta_next - r_next * e_v) / e - pull * beta_v
  by = (beta_v, beta_beta, beta_r, r_v, -pull * beta_beta, inertia * a / e - pull * beta_r)
  return (beta_next, r_next), by


def lateral_by_steering(
  speed: Any, acceleration: Any, car: SingleTrackCar, period: float, lib: ModuleType = math
) -> State:
  """Derivatives of sideslip and yaw rate after a period, as `lateral_step` makes them, by the road wheels' angle.

  Args:
    speed: v, m/s.  acceleration: v', m/s^2.
  """
  m, h, front, rear = car.mass, period, car.cornering_stiffness_front, car.cornering_stiffness_rear
  c1 = front * car.cg_to_front - rear * car.cg_to_rear
  c2 = front * car.cg_to_front**2 + rear * car.cg_to_rear**2
  a = lib.sqrt(speed * speed + STANDSTILL * STANDSTILL)
  e, g, twist = car.yaw_inertia * a + h * c2, h * (c1 + m * a * speed), h * front * car.cg_to_front
  bottom = m * a + h * (front + rear + m * (speed / a) * acceleration) - h * c1 * g / e
  by_beta = (h * front - g * twist / e) / bottom
  return by_beta, speed * (twist - h * c1 * by_beta) / e


def fill_jacobian(jacobian: Any, entries: State, period: float) -> None:
  """Write EKF_BM's Jacobian entries into (..., 6, 6), which must hold the identity's ones already."""
  xv, xyaw, xr, yv, yyaw, yr, vv, bv, bb, br, rv, rb, rr = entries
  jacobian[..., X, V], jacobian[..., X, YAW], jacobian[..., X, BETA], jacobian[..., X, R] = xv, xyaw, xyaw, xr
  jacobian[..., Y, V], jacobian[..., Y, YAW], jacobian[..., Y, BETA], jacobian[..., Y, R] = yv, yyaw, yyaw, yr
  jacobian[..., V, V], jacobian[..., YAW, R] = vv, period
  jacobian[..., BETA, V], jacobian[..., BETA, BETA], jacobian[..., BETA, R] = bv, bb, br
  jacobian[..., R, V], jacobian[..., R, BETA], jacobian[..., R, R] = rv, rb, rr


def point_step(state: State, accel: State, yaw: Any, period: float, lib: ModuleType = math) -> State:
  """EKF_PM's prediction: inertial acceleration R(psi) (a_x, a_y) held over the period.

  Args:
    state: X, Y, V_x, V_y in inertial axes.
    accel: body-frame acceleration of the centre of gravity, m/s^2.
    yaw: psi-hat of EKF_BM, rad.
  """
  x, y, vx, vy = state
  cos, sin = lib.cos(yaw), lib.sin(yaw)
  ax, ay = accel[0] * cos - accel[1] * sin, accel[0] * sin + accel[1] * cos
  h = period
  return x + h * vx + 0.5 * h * h * ax, y + h * vy + 0.5 * h * h * ay, vx + h * ax, vy + h * ay


def cg_acceleration(accel: State, yaw_rate: Any, lever: tuple[float, float]) -> State:
  """Specific force at the IMU brought to the centre of gravity: a + r^2 l (the r-dot term is left out, it is noise)."""
  turn = yaw_rate * yaw_rate
  return accel[0] + turn * lever[0], accel[1] + turn * lever[1]


def lateral_acceleration(state: State, steering: Any, car: SingleTrackCar, lib: ModuleType = math) -> tuple[Any, State]:
  """a_y = (F_front + F_rear) / m at the centre of gravity, m/s^2, and its derivatives by v, beta, r."""
  _, _, v, _, beta, r = state
  a = lib.sqrt(v * v + STANDSTILL * STANDSTILL)
  s = v / a
  c0 = car.cornering_stiffness_front + car.cornering_stiffness_rear
  c1 = car.cornering_stiffness_front * car.cg_to_front - car.cornering_stiffness_rear * car.cg_to_rear
  pull = car.cornering_stiffness_front * steering - c0 * beta
  force = s * pull - c1 * r / a
  by_v = (1.0 - s * s) / a * pull + c1 * r * s / (a * a)
  return force / car.mass, (by_v / car.mass, -s * c0 / car.mass, -c1 / (a * car.mass))
