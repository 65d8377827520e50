"""A single track of a 1:10 car with slipping tyres, a servo and a motor, in one file that needs nothing but NumPy.

State x (see STATES): position of the centre of gravity [m], heading [rad], velocity in the car's axes [m/s], yaw rate
[rad/s], steering angle [rad], slips of the front and the rear tyre [-], rate of the steering angle [rad/s]; behind them
memories of the effects that the car has (`state_names`). Commands u: of the drive [V on the motor, else A or m/s],
steering angle [rad], held over one period of PERIOD s. Axes and signs are those of ISO 8855: x forward, y left, angles
counter-clockwise.

  m (v_y' + v_x r) = F_yf cos d + F_yr + S_f sin d,  I r' = a (F_yf cos d + S_f sin d) - b F_yr
  F_y = -C z g(rho),  g(rho) = sin(B atan(rho / B)) / rho,  rho = sqrt((C z)^2 + F_x^2) / (mu F_z)
  sigma z' + w z = v_lateral,  w = sqrt(v_x^2 + v_y^2 + v_0^2)
  v_x' = v_y r + G R (P1 V - P2 w_m - P3 sgn w_m) + (forces across the car that have a part along it) / m_e

w_m is the motor's speed, G R its travel per radian, m_e the mass with all that turns. S is what the axles, coupled by
the drive, do to each other in a turn: their shaft turns so that both axles' forces along, of tyres whose slip they
share, add up to the drive's; S_f the whole force along the front wheels. Forces are implicit in the velocity at the end
of a step, so the step is stable at any speed, standing car included.
Source: Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, ch. 1, 4 and 7 (single track, similarity, stretched string).
"""

import math
from typing import Any

import numpy as np

Numbers = dict[str, Any]
PERIOD, PARTS = 0.01, 4  # s, and steps of integration in it
GRAVITY = 9.80665  # m/s^2
SHARED = 4  # rounds in which two axles on a shaft share what they slip; see docs/results/exports.md
CREEP = 0.005  # m/s, v_0: slip is finite at standstill
KINK = 1e-3  # rad and V: half-width over which corners of maps are rounded
STATES = (
  "pose_x", "pose_y", "pose_yaw", "velocity_x", "velocity_y", "yaw_rate", "steering_angle", "slip_front", "slip_rear",
  "steering_rate",
)  # fmt: skip
SENSED = ("yaw_rate", "accel_x", "accel_y", "motor_speed", "steering_angle")


def delay_cells(car: Numbers) -> tuple[int, ...]:
  """Past commands that are kept for the drive's and for the steering's delay."""
  return tuple(math.ceil(car.get(name, 0.0) / PERIOD) for name in ("drive_delay", "steering_delay"))


def state_names(car: Numbers) -> tuple[str, ...]:
  """Names of all states: STATES, then the memories of this car's effects."""
  drive, steering = delay_cells(car)
  memories = [f"drive_{k + 1}_ago" for k in range(drive)] + [f"steering_{k + 1}_ago" for k in range(steering)]
  for lag in ("drive_lag", "steering_lag"):
    memories += [lag, f"{lag}_rate"] if lag in car else []
  return (*STATES, *memories, *(["sag"] if "battery_sag" in car else []))


def at_start(car: Numbers, start: Any, command: Any) -> np.ndarray:
  """State (..., n) of a car at (..., 7), the first of STATES, that held commands (..., 2) until now."""
  x = np.zeros((*np.shape(start)[:-1], len(state_names(car))))
  x[..., :7] = start
  drive, steering = delay_cells(car)
  first = len(STATES)
  x[..., first : first + drive] = np.asarray(command)[..., :1]
  x[..., first + drive : first + drive + steering] = x[..., 6:7]
  place = first + drive + steering
  for lag, before in (("drive_lag", np.asarray(command)[..., 0]), ("steering_lag", x[..., 6])):
    if lag in car:
      x[..., place] = before
      place += 2
  return x


def motion(x: np.ndarray) -> np.ndarray:
  """Position, heading, velocity in the car's axes and yaw rate, (..., 6)."""
  return x[..., :6]


def step(x: np.ndarray, u: np.ndarray, car: Numbers) -> tuple[np.ndarray, np.ndarray]:
  """State after a period (..., n) and what sensors show then (..., 5), see SENSED; from x (..., n) and u (..., 2)."""
  after, sensed = advance(np, [x[..., i] for i in range(x.shape[-1])], [u[..., i] for i in range(2)], car)
  return np.stack(np.broadcast_arrays(*after), axis=-1), np.stack(np.broadcast_arrays(*sensed), axis=-1)


def casadi_step(car: Numbers) -> Any:
  """The same as a CasADi function (x, u) -> (x after, sensed), for optimal control; needs the package casadi."""
  import casadi  # pyright: ignore[reportMissingImports]

  x, u = casadi.SX.sym("x", len(state_names(car))), casadi.SX.sym("u", 2)

  class Functions:
    """CasADi's functions by NumPy's names."""

    sqrt, sin, cos, arctan, exp = casadi.sqrt, casadi.sin, casadi.cos, casadi.atan, casadi.exp
    minimum, maximum = casadi.fmin, casadi.fmax

  after, sensed = advance(Functions, casadi.vertsplit(x), casadi.vertsplit(u), car)
  names = (["x", "u"], ["x_after", "sensed"])
  return casadi.Function("single_track", [x, u], [casadi.vertcat(*after), casadi.vertcat(*sensed)], *names)


def advance(m: Any, x: list[Any], u: list[Any], car: Numbers) -> tuple[list[Any], list[Any]]:
  """One period; `m` has the functions, x and u are lists of scalars or arrays, `car` the numbers by name."""
  core = list(x[: len(STATES)])
  voltage, target, memory = commanded(m, core[3], list(x[len(STATES) :]), u, car)
  duration, lag = PERIOD / PARTS, car["servo_time_constant"]
  a, b, c, d = servo(lag, car["servo_inertia"], duration)
  for _ in range(PARTS):
    off, pace = core[6] - target, lag * core[9]
    steered, turning = target + a * off + b * pace, (c * off + d * pace) / lag
    if "servo_rate" in car:
      most = car["servo_rate"]
      steered = core[6] + m.minimum(m.maximum(steered - core[6], -most * duration), most * duration)
      turning = m.minimum(m.maximum(turning, -most), most)
    core, sensed = move(m, core, voltage, 0.5 * (core[6] + steered), duration, car)
    core[6], core[9] = steered, turning
  return core + memory, [*sensed, core[6]]


def servo(lag: Any, inertia: Any, duration: float) -> tuple[Any, Any, Any, Any]:
  """Exact step of inertia lag^2 y'' + lag y' + y = u, u held: e = y - u goes to a e + b w, w = lag y' to c e + d w."""
  inertia = np.maximum(inertia, 1e-6)  # of first order within a microradian
  root = np.sqrt(1.0 - 4.0 * inertia + 0j)
  root = np.where(np.abs(root) < 1e-5, 1e-5, root)  # a double pole as two close ones
  slow, fast = -2.0 / (1.0 + root), -(1.0 + root) / (2.0 * inertia)
  left, gone = np.exp(slow * duration / lag), np.exp(fast * duration / lag)
  b = (left - gone) / (slow - fast)
  a, c, d = (slow * gone - fast * left) / (slow - fast), -slow * fast * b, (slow * left - fast * gone) / (slow - fast)
  return a.real, b.real, c.real, d.real


def commanded(m: Any, speed: Any, memory: list[Any], u: list[Any], car: Numbers) -> tuple[Any, Any, list[Any]]:
  """What reaches motor [V] and servo [rad] of the commands: delays, lags, maps and the battery; and the memories."""
  voltage, angle = u
  drive, steering = delay_cells(car)
  voltage, past_drive = delayed(voltage, memory[:drive], car.get("drive_delay", 0.0))
  angle, past_steering = delayed(angle, memory[drive : drive + steering], car.get("steering_delay", 0.0))
  kept, rest = past_drive + past_steering, memory[drive + steering :]
  if "drive_lag" in car:
    voltage, state = lagged(voltage, rest[:2], car, "drive")
    kept, rest = kept + state, rest[2:]
  if "steering_lag" in car:
    angle, state = lagged(angle, rest[:2], car, "steering")
    kept, rest = kept + state, rest[2:]
  angle = angle * (1.0 + car.get("steering_gain_error", 0.0))
  if "steering_asymmetry" in car:
    angle = angle + car["steering_asymmetry"] * (m.sqrt(angle * angle + KINK * KINK) - KINK)
  angle = angle + car.get("steering_offset", 0.0)
  angle = m.minimum(m.maximum(angle, -car["max_steering"]), car["max_steering"])
  if "battery_sag" not in car:
    return voltage, angle, kept
  idle = car["drive_damping"] / car["drive_gain"] * speed / car["travel_per_radian"]
  current = m.maximum(voltage * (voltage - idle) / 2.5**2, 0.0)
  current = current * current / (current + 0.005)
  target = car["battery_sag"] * (current + 1e-12) ** car["battery_sag_power"]
  drop = rest[0] + (target - rest[0]) * (1.0 - m.exp(-PERIOD / car["battery_sag_time"]))
  return voltage / (1.0 + drop), angle, [*kept, drop]


def delayed(command: Any, past: list[Any], delay: float) -> tuple[Any, list[Any]]:
  """The command of `delay` s ago, the mean over the period, and the commands to remember, latest first."""
  if not past:
    return command, []
  line, whole = [command, *past], int(delay / PERIOD)
  part = delay / PERIOD - whole
  late = line[whole] if whole + 1 >= len(line) else (1.0 - part) * line[whole] + part * line[whole + 1]
  return late, line[:-1]


def lagged(command: Any, state: list[Any], car: Numbers, which: str) -> tuple[Any, list[Any]]:
  """Mean over the period of a second-order lag's answer, and its state; exact for a held command."""
  a, b, c, d = car[f"{which}_lag_transition"]
  inertia, steps = car[f"{which}_lag_inertia"], PERIOD / car[f"{which}_lag"]
  error = state[0] - command
  output, rate = command + a * error + b * state[1], c * error + d * state[1]
  return command - (inertia * (rate - state[1]) + output - state[0]) / steps, [output, rate]


def move(
  m: Any, core: list[Any], voltage: Any, steered: Any, duration: float, car: Numbers
) -> tuple[list[Any], list[Any]]:
  """One step of integration with the road wheels at `steered` [rad]."""
  px, py, yaw, vx, vy, r, angle, slip_front, slip_rear, pace = core
  mass, inertia, a, b = car["mass"], car["yaw_inertia"], car["cg_to_front"], car["cg_to_rear"]
  travel, sine, cosine = car["travel_per_radian"], m.sin(steered), m.cos(steered)
  w = m.sqrt(vx * vx + vy * vy + CREEP * CREEP)
  # along the car
  push = travel * (car["drive_gain"] * voltage - car["drive_damping"] * vx / travel)
  stick, rushing = duration * travel * car["drive_friction"], vx + duration * push
  drive = mass * (push - m.minimum(m.maximum(rushing, -stick), stick) / duration)  # none while friction holds the car
  front_speed = cosine * vx + sine * (vy + a * r)
  share = car["drive_front"]
  both = 4.0 * share * (1.0 - share)  # 1 where a shaft drives both axles, 0 where one is driven
  # across it: stiffness of each axle as it slips now
  transfer = drive * car["cg_height"] / (a + b)
  load_front = m.maximum(mass * GRAVITY * b / (a + b) - transfer, 0.1 * mass)
  load_rear = m.maximum(mass * GRAVITY * a / (a + b) + transfer, 0.1 * mass)
  gives_front = gives_rear = 1.0
  for _ in range(SHARED):  # what one axle pushes the other holds against; the one that gives less slips more
    uneven = 0.5 * both * w * drive * (share / gives_front - (1.0 - share) / gives_rear)
    wound = car["coupling"] * (front_speed - vx) + uneven
    scrub = wound / (0.5 * w * (1.0 / gives_front + 1.0 / gives_rear) + car["coupling"] * car["centre_compliance"])
    linear_front = (share * drive - scrub) / (both * gives_front + 1.0 - both)
    linear_rear = ((1.0 - share) * drive + scrub) / (both * gives_rear + 1.0 - both)
    hold_front, bias_front, gives_front = axle(m, car, "front", slip_front, linear_front, load_front, w, duration)
    hold_rear, bias_rear, gives_rear = axle(m, car, "rear", slip_rear, linear_rear, load_rear, w, duration)
  along_front = share * drive - scrub
  ahead = w * (1.0 + both) / car["longitudinal_stiffness"]  # slip speed per linear force of an axle
  lead = share * (front_speed - vx + ahead * linear_front) + (1.0 - share) * ahead * linear_rear  # of shaft over car
  side_x, side_y, side_moment = pushes(m, vx, vy, w, car)
  k = hold_front * cosine * cosine
  out = hold_front * cosine * sine * vx - cosine * bias_front + along_front * sine
  m11, m12 = mass / duration + k + hold_rear, mass * vx + a * k - b * hold_rear
  m21, m22 = a * k - b * hold_rear, inertia / duration + a * a * k + b * b * hold_rear
  f1 = mass / duration * vy + out - bias_rear + side_y
  f2 = inertia / duration * r + a * out + b * bias_rear + side_moment
  determinant = m11 * m22 - m12 * m21
  vy_after, r_after = (f1 * m22 - f2 * m12) / determinant, (f2 * m11 - f1 * m21) / determinant
  lateral = cosine * (vy_after + a * r_after) - sine * vx
  across = -(hold_front * lateral + bias_front)
  relaxation = car["relaxation_length"]
  slip_front = (relaxation * slip_front + duration * lateral) / (relaxation + duration * w)
  slip_rear = (relaxation * slip_rear + duration * (vy_after - b * r_after)) / (relaxation + duration * w)
  # the speed: friction never turns the car round
  other = (-across * sine - scrub * (cosine - 1.0) + side_x + mass * vy * r) / car["moved_mass"]
  other = other - car["drive_damping"] * lead
  free = (vx + duration * (travel * car["drive_gain"] * voltage + other)) / (1.0 + duration * car["drive_damping"])
  vx_after = free - m.minimum(m.maximum(free, -stick), stick)
  speeds = 0.5 * (vx + vx_after), 0.5 * (vy + vy_after)
  heading = yaw + 0.5 * duration * r_after
  px = px + duration * (m.cos(heading) * speeds[0] - m.sin(heading) * speeds[1])
  py = py + duration * (m.sin(heading) * speeds[0] + m.cos(heading) * speeds[1])
  after = [px, py, yaw + duration * r_after, vx_after, vy_after, r_after, angle, slip_front, slip_rear, pace]
  felt_x = (vx_after - vx) / duration - vy * r_after
  felt_y, turn = (vy_after - vy) / duration + vx * r_after, (r_after - r) / duration
  felt_x = (felt_x - turn * car["imu_y"] - r_after**2 * car["imu_x"]) * car["pitch_gain"]
  felt_y = (felt_y + turn * car["imu_x"] - r_after**2 * car["imu_y"]) * car["roll_gain"]
  return after, [r_after, felt_x, felt_y, (vx_after + lead) / travel]


def axle(
  m: Any, car: Numbers, name: str, slip: Any, along: Any, load: Any, w: Any, duration: float
) -> tuple[Any, Any, Any]:
  """Force against the slip velocity at the step's end, N s/m, the force that is there without any, N, and what share of
  the forces without a limit, across and `along`, N, the tyres give."""
  stiffness = car[f"cornering_stiffness_{name}"]
  static = car["mass"] * GRAVITY * car["cg_to_rear" if name == "front" else "cg_to_front"]
  share = load * (car["cg_to_front"] + car["cg_to_rear"]) / static
  stiffness = stiffness * share ** (1.0 - car["load_exponent"])
  most = car["friction_coefficient"] * load * share ** (-car["load_exponent"])
  wanted = m.sqrt((stiffness * slip) ** 2 + along**2 + 1e-12) / most
  gives = saturation(m, wanted, car)
  secant = stiffness * gives
  relaxation = car["relaxation_length"]
  part = 1.0 / (relaxation + duration * w)
  return secant * duration * part, secant * relaxation * part * slip, gives


def saturation(m: Any, wanted: Any, car: Numbers) -> Any:
  """Share of a force that a tyre gives, g(rho), of what it would without a limit, over the limit: rho."""
  shape = car["tyre_shape"]
  return m.sin(shape * m.arctan(wanted / shape)) / wanted


def pushes(m: Any, vx: Any, vy: Any, w: Any, car: Numbers) -> tuple[Any, Any, Any]:
  """Forces of named effects on the body: along, across [N], moment [N m]."""
  drag, side = car.get("quadratic_drag", 0.0), car.get("side_force", 0.0)
  side = side * vx * vx / (vx * vx + 0.05**2)
  return -drag * w * vx, side - drag * w * vy, car.get("side_force_x", 0.0) * side
