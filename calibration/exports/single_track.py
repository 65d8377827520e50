"""A single track of a 1:10 car with slipping tyres, a servo and a motor, in one file that needs nothing but NumPy.

State x (see STATES): position of the centre of gravity [m], heading [rad], velocity in the car's axes [m/s], yaw rate
[rad/s], steering angle [rad], slips of the front and the rear tyre across [-], rate of the steering angle [rad/s], rim
speed of the motor's shaft [m/s]; behind them memories of the effects that the car has (`state_names`). Commands u: of
the drive [V on the motor, else A or m/s], steering angle [rad], held over one period of PERIOD s. Axes and signs are
those of ISO 8855: x forward, y left, angles counter-clockwise.

  m (v_y' + v_x r) = F_yf cos d + F_yr + F_xf sin d,  I r' = a (F_yf cos d + F_xf sin d) - b F_yr
  m_b (v_x' - v_y r) = F_xf cos d + F_xr - F_yf sin d,  m_s V' = m_e (G R P1 V_m - P2 V - G R P3 sgn V) - F_xf - F_xr
  (F_x, F_y) = -(C_x s, C_y z) g(rho),  g(rho) = sin(B atan(rho / B)) / rho,  rho = |(C_x s, C_y z)| / (mu F_z)
  sigma z' + w z = v_across,  w s = v_along - V_i,  w = sqrt(V_i^2 + (v_along - V_i)^2 + v_across^2 + v_0^2)

V is the rim speed of the motor's shaft, G R times the motor's speed, and V_m the voltage on the motor; m_e is the mass
with all that turns, m_s what the motor turns of it, m_b the rest. V_i is the rim speed of an axle: V where one is
driven; two share V, but for what the centre differential's damping lets one turn faster. Forces are implicit in the
velocities at the end of a step, so the step is stable at any speed, standing car included.
Source: Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, ch. 1, 4 and 7 (single track, similarity, stretched string).
"""

import math
from typing import Any

import numpy as np

Numbers = dict[str, Any]
PERIOD, PARTS = 0.01, 4  # s, and steps of integration in it
GRAVITY = 9.81  # m/s^2, the twin's
LEAST_LOAD = 0.02  # of an axle's static load: what remains on it where the other takes all
ROUNDS = 2  # of a step, in which forces and loads come to go with the speeds along at its end
CREEP = 0.005  # m/s, v_0: slip is finite at standstill
KINK = 1e-3  # rad and V: half-width over which corners of maps are rounded
STATES = (
  "pose_x", "pose_y", "pose_yaw", "velocity_x", "velocity_y", "yaw_rate", "steering_angle", "slip_front", "slip_rear",
  "steering_rate", "shaft_speed",
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
  ahead, front = x[..., 3], car["drive_front"]
  at_front = np.cos(x[..., 6]) * ahead + np.sin(x[..., 6]) * (x[..., 4] + car["cg_to_front"] * x[..., 5])
  x[..., STATES.index("shaft_speed")] = front * at_front + (1.0 - front) * ahead  # its wheels roll
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
  voltage, target, memory = commanded(m, core[10], list(x[len(STATES) :]), u, car)
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


def commanded(m: Any, rim: Any, memory: list[Any], u: list[Any], car: Numbers) -> tuple[Any, Any, list[Any]]:
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
  idle = car["drive_damping"] / car["drive_gain"] * rim / car["travel_per_radian"]
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
  px, py, yaw, vx, vy, r, angle, slip_front, slip_rear, pace, shaft = core
  mass, inertia, a, b = car["mass"], car["yaw_inertia"], car["cg_to_front"], car["cg_to_rear"]
  sine, cosine = m.sin(steered), m.cos(steered)
  side_x, side_y, side_moment = pushes(m, vx, vy, m.sqrt(vx * vx + vy * vy + CREEP * CREEP), car)
  along_x = side_x + mass * vy * r
  (hold_front, bias_front, pull_front, w_front), (hold_rear, bias_rear, pull_rear, w_rear), thrust = gripping(
    m, core, voltage, (cosine, sine), along_x, duration, car
  )
  k = hold_front * cosine * cosine
  out = hold_front * cosine * sine * vx - cosine * bias_front + thrust * sine
  m11, m12 = mass / duration + k + hold_rear, mass * vx + a * k - b * hold_rear
  m21, m22 = a * k - b * hold_rear, inertia / duration + a * a * k + b * b * hold_rear
  f1 = mass / duration * vy + out - bias_rear + side_y
  f2 = inertia / duration * r + a * out + b * bias_rear + side_moment
  determinant = m11 * m22 - m12 * m21
  vy_after, r_after = (f1 * m22 - f2 * m12) / determinant, (f2 * m11 - f1 * m21) / determinant
  lateral = cosine * (vy_after + a * r_after) - sine * vx
  along_x = along_x + (hold_front * lateral + bias_front) * sine
  front, pull = (cosine, sine * (vy_after + a * r_after)), (pull_front, pull_rear)
  shaft, vx_after, _, _ = along(m, car, (shaft, vx), voltage, pull, front, along_x, duration)
  relaxation = car["relaxation_length"]
  slip_front = (relaxation * slip_front + duration * lateral) / (relaxation + duration * w_front)
  slip_rear = (relaxation * slip_rear + duration * (vy_after - b * r_after)) / (relaxation + duration * w_rear)
  heading = yaw + 0.5 * duration * r_after
  speeds = 0.5 * (vx + vx_after), 0.5 * (vy + vy_after)
  px = px + duration * (m.cos(heading) * speeds[0] - m.sin(heading) * speeds[1])
  py = py + duration * (m.sin(heading) * speeds[0] + m.cos(heading) * speeds[1])
  after = [px, py, yaw + duration * r_after, vx_after, vy_after, r_after, angle, slip_front, slip_rear, pace, shaft]
  felt_x = (vx_after - vx) / duration - vy * r_after
  felt_y, turn = (vy_after - vy) / duration + vx * r_after, (r_after - r) / duration
  felt_x = (felt_x - turn * car["imu_y"] - r_after**2 * car["imu_x"]) * car["pitch_gain"]
  felt_y = (felt_y + turn * car["imu_x"] - r_after**2 * car["imu_y"]) * car["roll_gain"]
  return after, [r_after, felt_x, felt_y, shaft / car["travel_per_radian"]]


def gripping(
  m: Any, core: list[Any], voltage: Any, turned: Any, force: Any, duration: float, car: Numbers
) -> tuple[Any, Any, Any]:
  """What `axle` says of front and rear, under the loads and speeds along at the step's end, and the front's push [N].

  `turned`: cosine and sine of the road wheels' angle; `force`: on the body along, but for the tyres' [N].
  """
  vx, vy, r, slip_front, slip_rear, shaft = (core[i] for i in (3, 4, 5, 7, 8, 10))
  (cosine, sine), a, b = turned, car["cg_to_front"], car["cg_to_rear"]
  sideways, static = vy + a * r, car["mass"] * GRAVITY / (a + b)
  aside_front, aside_rear = cosine * sideways - sine * vx, vy - b * r
  front = rear = (0.0, 0.0, 0.0, 0.0)
  rim, ahead, transfer, thrust = shaft, vx, 0.0, 0.0
  for _ in range(ROUNDS):
    speeds, pull = (cosine * ahead + sine * sideways, ahead), (front[2], rear[2])
    rims = rim_speeds(car, rim, speeds, pull)
    load_front = m.maximum(static * b - transfer, LEAST_LOAD * static * b)
    load_rear = m.maximum(static * a + transfer, LEAST_LOAD * static * a)
    front = axle(m, car, "front", slip_front, rims[0], speeds[0], aside_front, load_front, duration)
    rear = axle(m, car, "rear", slip_rear, rims[1], speeds[1], aside_rear, load_rear, duration)
    left = force + (front[0] * aside_front + front[1]) * sine
    pull, swing = (front[2], rear[2]), sine * sideways
    rim, ahead, thrust, other = along(m, car, (shaft, vx), voltage, pull, (cosine, swing), left, duration)
    transfer = (thrust + other) * car["cg_height"] / (a + b)
  return front, rear, thrust


def along(
  m: Any, car: Numbers, start: Any, voltage: Any, pull: Any, front: Any, force: Any, duration: float
) -> tuple[Any, Any, Any, Any]:
  """Rim speed of the shaft and speed of the car at a step's end [m/s], and what the front and rear tyres push [N].

  `start`: both speeds at its beginning; `pull`: force of each axle per speed of its rim over the ground [N s/m];
  `front`: the front tyres' speed along them is front[0] vx + front[1]; `force`: any other on the body [N].
  """
  (shaft, vx), (cosine, swing) = start, front
  share, soft = car["drive_front"], car["centre_compliance"]
  other = 1.0 - share
  one, two = pull
  # an axle's push by its own lag behind the shaft, and by the other's
  loose = 1.0 + soft * (other**2 * one + share**2 * two)
  own_front, own_rear = one * (1.0 + soft * share**2 * two) / loose, two * (1.0 + soft * other**2 * one) / loose
  cross = soft * share * other * one * two / loose
  both_front, both_rear = own_front + cross, own_rear + cross  # on the shaft
  body_front, body_rear = cosine * own_front + cross, cosine * cross + own_rear  # on the body
  turning, moved = car["shaft_mass"], car["moved_mass"]
  s11 = turning / duration + moved * car["drive_damping"] + both_front + both_rear
  s12, s21 = -(both_front * cosine + both_rear), -(body_front + body_rear)
  s22 = (moved - turning) / duration + body_front * cosine + body_rear
  on_shaft = turning / duration * shaft + moved * car["travel_per_radian"] * car["drive_gain"] * voltage
  on_shaft = on_shaft + both_front * swing
  on_body = (moved - turning) / duration * vx - body_front * swing + force
  whole = s11 - s12 * s21 / s22
  free = (on_shaft - s12 * on_body / s22) / whole
  stick = moved * car["travel_per_radian"] * car["drive_friction"] / whole  # friction never turns a shaft round
  rim = free - m.minimum(m.maximum(free, -stick), stick)
  ahead = (on_body - s21 * rim) / s22
  lag_front, lag_rear = rim - cosine * ahead - swing, rim - ahead
  return rim, ahead, own_front * lag_front + cross * lag_rear, cross * lag_front + own_rear * lag_rear


def rim_speeds(car: Numbers, shaft: Any, speeds: Any, pull: Any) -> tuple[Any, Any]:
  """Rim speed of the front and the rear axle [m/s], whose tyres go at `speeds`; one that is not driven rolls."""
  share, soft = car["drive_front"], car["centre_compliance"]
  if share in (0.0, 1.0):
    return (shaft, speeds[1]) if share else (speeds[0], shaft)
  other = 1.0 - share
  faster = share * pull[1] * (shaft - speeds[1]) - other * pull[0] * (shaft - speeds[0])
  faster = soft * faster / (1.0 + soft * (other**2 * pull[0] + share**2 * pull[1]))
  return shaft + other * faster, shaft - share * faster


def axle(
  m: Any, car: Numbers, name: str, slip: Any, rim: Any, ahead: Any, aside: Any, load: Any, duration: float
) -> tuple[Any, Any, Any, Any]:
  """Force against the slip velocity across at the step's end, N s/m, the force that is there without any, N, that along
  per speed of the rim over the ground, N s/m, and the speed that slip is counted by, m/s."""
  across, along = car[f"cornering_stiffness_{name}"], car[f"longitudinal_stiffness_{name}"]
  static = car["mass"] * GRAVITY * car["cg_to_rear" if name == "front" else "cg_to_front"]
  share = load * (car["cg_to_front"] + car["cg_to_rear"]) / static
  stiffer = share ** (1.0 - car["load_exponent"])
  most = car["friction_coefficient"] * load * share ** (-car["load_exponent"])
  w = m.sqrt(rim * rim + (ahead - rim) ** 2 + aside * aside + CREEP * CREEP)
  part = 1.0 / (car["relaxation_length"] + duration * w)
  reached = part * (car["relaxation_length"] * slip + duration * aside)
  wanted = m.sqrt((across * reached) ** 2 + (along * (ahead - rim) / w) ** 2 + 1e-12) * stiffer / most
  gives = saturation(m, wanted, car) * stiffer
  return across * gives * duration * part, across * gives * car["relaxation_length"] * part * slip, along * gives / w, w


def saturation(m: Any, wanted: Any, car: Numbers) -> Any:
  """Share of a force that a tyre gives, g(rho), of what it would without a limit, over the limit: rho."""
  shape = car["tyre_shape"]
  return m.sin(shape * m.arctan(wanted / shape)) / wanted


def pushes(m: Any, vx: Any, vy: Any, w: Any, car: Numbers) -> tuple[Any, Any, Any]:
  """Forces of named effects on the body: along, across [N], moment [N m]."""
  drag, side = car.get("quadratic_drag", 0.0), car.get("side_force", 0.0)
  side = side * vx * vx / (vx * vx + 0.05**2)
  return -drag * w * vx, side - drag * w * vy, car.get("side_force_x", 0.0) * side
