"""What the driver is asked to do: manoeuvres on the 10 ms grid, and the paths that they follow."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

PERIOD = 0.01  # s, control and logging
SPACING = 0.02  # m between points of a path
DEGREE = np.pi / 180
SLEW = 3.0  # rad/s, steepest change of the steering command in a step


@dataclass(frozen=True)
class Path:
  """A line to follow: points every SPACING metres, (M,) each; x, y [m], yaw [rad, unwrapped], curvature [1/m]."""

  x: np.ndarray
  y: np.ndarray
  yaw: np.ndarray
  curvature: np.ndarray

  @classmethod
  def from_curvature(cls, curvature: np.ndarray, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Path:
    """Integrate curvature (M,) [1/m] along the arc from a first point."""
    heading = yaw + SPACING * (np.cumsum(curvature) - 0.5 * curvature)
    return cls(x + SPACING * np.cumsum(np.cos(heading)), y + SPACING * np.cumsum(np.sin(heading)), heading, curvature)


@dataclass(frozen=True)
class Manoeuvre:
  """One run. `steer` [rad] is added to the path follower's angle; where `speed` [m/s] is NaN, `volts` acts open loop:
  a voltage, or what else the car's drive takes.
  Arrays (T,).
  """

  name: str
  kind: str
  role: str
  steer: np.ndarray
  speed: np.ndarray
  volts: np.ndarray
  start: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # m, m, rad, m/s
  path: Path | None = None
  session: str = field(default="morning")

  @property
  def ticks(self) -> int:
    """Control periods of the run."""
    return len(self.steer)


def clock(duration: float) -> np.ndarray:
  """Times of the commands (T,) [s]."""
  return PERIOD * np.arange(round(duration / PERIOD))


def smooth(values: np.ndarray, width: int) -> np.ndarray:
  """A centred moving average of odd width, ends held."""
  padded = np.pad(values, width // 2, mode="edge")
  return np.convolve(padded, np.ones(width) / width, mode="valid")


def held(rng: np.random.Generator, length: int, levels: np.ndarray, shortest: float, longest: float) -> np.ndarray:
  """Levels drawn at random and held for random times [s]: (length,)."""
  out = np.empty(length)
  k = 0
  while k < length:
    stop = k + max(1, round(rng.uniform(shortest, longest) / PERIOD))
    out[k:stop] = rng.choice(levels)
    k = stop
  return out


def open_loop(
  name: str,
  kind: str,
  role: str,
  volts: np.ndarray,
  steer: np.ndarray | float = 0.0,
  start: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
) -> Manoeuvre:
  """Voltage and steering as written."""
  return Manoeuvre(
    name, kind, role, np.broadcast_to(steer, volts.shape).astype(float), np.full(volts.shape, np.nan), volts, start
  )


def at_speed(
  name: str,
  kind: str,
  role: str,
  speed: np.ndarray,
  steer: np.ndarray | float = 0.0,
  start: tuple[float, float, float] = (0.0, 0.0, 0.0),
  path: Path | None = None,
) -> Manoeuvre:
  """Speed held by the driver, steering as written or along a path; starts rolling at speed[0]."""
  steering = np.broadcast_to(steer, speed.shape).astype(float)
  return Manoeuvre(name, kind, role, steering, speed, np.zeros(speed.shape), (*start, float(speed[0])), path)


def voltage_step(volts: float, role: str, duration: float = 5.5) -> Manoeuvre:
  """From rest, after half a second, a step held to the end."""
  time = clock(duration)
  return open_loop(
    f"voltage_step_{volts:g}V", "voltage_step", role, np.where(time < 0.5, 0.0, volts), start=(-4.5, 0.0, 0.0, 0.0)
  )


def steering_step(degrees: float, role: str, duration: float = 5.5, speed: float = 1.5) -> Manoeuvre:
  """Rolling straight for a second, then a step of the wheel held to the end; the car's software slews the command, or
  the front tyres would slide through every step."""
  time = clock(duration)
  steer = np.clip((time - 0.99) * SLEW, 0.0, degrees * DEGREE)
  return at_speed(
    f"steering_step_{degrees:g}deg", "steering_step", role, np.full(time.shape, speed), steer, start=(-1.5, -1.0, 0.0)
  )


def ramp_steer(
  duration: float = 12.0, speed: float = 1.5, most: float = 24.0, role: str = "identify", name: str = "ramp_steer"
) -> Manoeuvre:
  """Steering wound on slowly at constant speed, up to `most` degrees."""
  time = clock(duration)
  steer = np.clip((time - 1.0) / (duration - 2.0), 0.0, 1.0) * most * DEGREE
  return at_speed(name, "ramp_steer", role, np.full(time.shape, speed), steer, start=(-3.0, -2.0, 0.0))


def throttle_in_turn(duration: float, role: str = "identify", degrees: float = 11.0) -> Manoeuvre:
  """Power on, off and against, in a turn to the left and then to the right."""
  time = clock(duration)
  levels = np.array([1.2, 2.8, 0.0, 2.2, -0.8, 3.2])
  volts = levels[(time / 1.1).astype(int) % len(levels)]
  steer = smooth(np.where(time < duration / 2, 1.0, -1.0), 21) * degrees * DEGREE
  return open_loop("throttle_in_turn", "throttle_in_turn", role, volts, steer, start=(0.0, -1.0, 0.0, 0.0))


def chirp(
  speed: float, duration: float, role: str, name: str, lean: float = 7.0, swing: float = 5.0, fastest: float = 5.0
) -> Manoeuvre:
  """Sine of rising frequency (0.3 Hz upward, geometric) about a steady angle."""
  time = clock(duration)
  growth = np.log(fastest / 0.3) / duration
  phase = 2 * np.pi * 0.3 * np.expm1(growth * time) / growth
  steer = (lean + swing * np.sin(phase)) * DEGREE
  return at_speed(name, "steering_chirp", role, np.full(time.shape, speed), steer, start=(0.0, -1.5, 0.0))


def circles(speed: float, degrees: float, duration: float, role: str, name: str) -> Manoeuvre:
  """Half the time to the left, half to the right."""
  time = clock(duration)
  steer = smooth(np.where(time < duration / 2, 1.0, -1.0), 21) * degrees * DEGREE
  return at_speed(name, "circle", role, np.full(time.shape, speed), steer, start=(0.0, -0.5, 0.0))


def staircase(volts: tuple[float, ...], duration: float, role: str, name: str, kind: str = "voltage_step") -> Manoeuvre:
  """Levels of the drive command of equal length after half a second of rest."""
  time = clock(duration)
  index = np.clip((time - 0.5) / (duration - 0.5) * len(volts), 0, len(volts) - 1e-9).astype(int)
  return open_loop(name, kind, role, np.where(time < 0.5, 0.0, np.array(volts)[index]), start=(-4.5, 1.0, 0.0, 0.0))


def pulses(levels: tuple[float, ...], duration: float, role: str, name: str) -> Manoeuvre:
  """From rest, the drive command at each level for an equal time, let go for the last two fifths of it."""
  time = clock(duration)
  part = duration / len(levels)
  index = np.minimum(time // part, len(levels) - 1).astype(int)
  return open_loop(name, "pulses", role, np.where(time % part < 0.6 * part, np.array(levels)[index], 0.0))


def speed_changes(rng: np.random.Generator, duration: float, role: str, name: str, quickest: float = 2.4) -> Manoeuvre:
  """Speeds that jump among random levels, with a little steering."""
  length = len(clock(duration))
  speed = held(rng, length, np.linspace(0.5, quickest, 6), 0.8, 1.6)
  steer = smooth(held(rng, length, np.array([-8, -4, 0, 4, 8]) * DEGREE, 0.5, 1.2), 5)
  return at_speed(name, "speed_changes", role, speed, steer)


def coast_downs(duration: float, role: str = "identify") -> Manoeuvre:
  """Three bursts of rising voltage, each let go to roll out."""
  time = clock(duration)
  third = duration / 3
  level = np.array([1.2, 2.2, 3.0])[np.minimum(time // third, 2).astype(int)]
  return open_loop(
    "coast_down", "coast_down", role, np.where(time % third < 0.38 * third, level, 0.0), start=(-4.5, 0.5, 0.0, 0.0)
  )


def drive_brake(rng: np.random.Generator, duration: float, role: str = "identify") -> Manoeuvre:
  """Hard changes between driving, letting go and reversing, a little steering."""
  length = len(clock(duration))
  sign = np.where(np.arange(length) // 70 % 2 == 0, 1.0, -1.0)
  volts = sign * held(rng, length, np.array([1.4, 2.0, 2.6]), 0.7, 0.7)
  volts[np.arange(length) % 140 > 120] = 0.0
  volts[:50] = 0.0
  return open_loop(
    "drive_brake",
    "drive_brake",
    role,
    volts + 0.3 * (volts != 0),
    held(rng, length, np.array([-6.0, 0.0, 6.0]) * DEGREE, 0.5, 1.5),
  )


def excitation(rng: np.random.Generator, duration: float, role: str, name: str, reverse: bool = True) -> Manoeuvre:
  """Voltage and steering both jump among random levels of both signs."""
  length = len(clock(duration))
  levels = np.array([-1.6, -0.9, 0.0, 0.8, 1.3, 1.8, 2.4]) if reverse else np.array([0.6, 1.0, 1.5, 2.0, 2.5])
  volts = held(rng, length, levels, 0.25, 1.0)
  steer = smooth(held(rng, length, np.array([-16, -11, -6, -2, 2, 6, 11, 16]) * DEGREE, 0.2, 0.9), 5)
  return open_loop(name, "excitation", role, volts, steer)


def standstill(duration: float, role: str = "identify") -> Manoeuvre:
  """Nothing moves; the wheel is turned a little at the end of it."""
  time = clock(duration)
  return open_loop(
    "standstill", "standstill", role, np.zeros(time.shape), np.where(time > duration - 0.8, 5 * DEGREE, 0.0)
  )


def oval(speed: float, duration: float, role: str, name: str = "oval") -> Manoeuvre:
  """Straights of 2.4 m and half circles of 0.9 m radius, entered softly."""
  lap = np.concatenate([np.zeros(60), np.full(round(np.pi * 0.9 / SPACING), 1 / 0.9), np.zeros(60)])
  lap = np.tile(lap, 2)
  lap *= 2 * np.pi / (lap.sum() * SPACING)
  line = smooth(np.tile(lap, int(np.ceil(1.3 * speed * duration / (SPACING * len(lap)))) + 1), 25)
  path = Path.from_curvature(line, 0.0, -0.9)
  return at_speed(name, "oval", role, np.full(clock(duration).shape, speed), start=(0.0, -0.9, 0.0), path=path)


def figure_eight(speed: float, duration: float, role: str, radius: float = 0.85) -> Manoeuvre:
  """Full circles to either side in turn."""
  turn = np.full(round(2 * np.pi * radius / SPACING), 1 / radius)
  turns = int(np.ceil(1.3 * speed * duration / (2 * np.pi * radius))) + 1
  line = smooth(np.concatenate([np.zeros(15)] + [turn * (-1) ** i for i in range(turns)]), 21)
  path = Path.from_curvature(line)
  return at_speed(
    "figure_eight", "figure_eight", role, np.full(clock(duration).shape, speed), start=(0.0, 0.0, 0.0), path=path
  )


def free_drive(rng: np.random.Generator, duration: float, role: str, name: str, quickest: float = 1.8) -> Manoeuvre:
  """Round a closed line of random shape at a changing speed, lateral acceleration asked for below 3.2 m/s^2."""
  angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
  bulge = sum(rng.uniform(-0.10, 0.10) * np.cos(n * angle + rng.uniform(0, 2 * np.pi)) for n in (2, 3, 4))
  turn = rng.choice([-1.0, 1.0])
  x, y = 2.4 * (1 + bulge) * np.cos(angle), turn * 1.7 * (1 + bulge) * np.sin(angle)
  laps = int(np.ceil(1.4 * quickest * duration / 9.0)) + 1
  arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(np.r_[x, x[0]]), np.diff(np.r_[y, y[0]])))])
  at = np.arange(0.0, arc[-1], SPACING)
  xs, ys = np.interp(at, arc, np.r_[x, x[0]]), np.interp(at, arc, np.r_[y, y[0]])
  xs, ys = np.tile(xs, laps), np.tile(ys, laps)
  yaw = np.unwrap(np.arctan2(np.gradient(ys), np.gradient(xs)))
  curvature = smooth(np.gradient(smooth(yaw, 9)) / SPACING, 9)
  wish = smooth(held(rng, len(clock(duration)), np.linspace(0.5, quickest, 6), 1.0, 2.5), 61)
  path = Path(xs, ys, yaw, curvature)
  limit = np.sqrt(3.2 / max(1e-3, float(np.quantile(np.abs(curvature), 0.98))))
  return at_speed(
    name, "free_driving", role, np.minimum(wish, limit), start=(float(xs[0]), float(ys[0]), float(yaw[0])), path=path
  )
