"""A driver with a shaky hand: feedback on speed and line, tremor and reaction time; what comes out is logged."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from scipy.signal import lfilter

from .manoeuvres import PERIOD, SPACING, Manoeuvre, Path

ANGLE_STEP = 1e-4  # rad: resolution of the command, the same in car and log
BELIEFS = ("wheelbase", "speed_per_motor", "volts_per_speed", "volts_to_move", "max_steering")
BELIEFS += ("answer", "tremor", "limit", "step")
REACTION = 0.06  # s
STEPS = ("voltage_step", "duty_step", "speed_step")
AUTOMATED = ("standstill", *STEPS, "steering_step")  # nobody's hand is on the wheel


def coloured(rng: np.random.Generator, shape: tuple[int, ...], memory: float, period: float = PERIOD) -> np.ndarray:
  """First-order Gauss-Markov noise of unit variance along the first axis; memory [s] is its time constant."""
  keep = np.exp(-period / memory)
  white = rng.standard_normal(shape)
  white[0] /= np.sqrt(1 - keep**2)
  return np.asarray(lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], white, axis=0))


def shaking(rng: np.random.Generator, ticks: int, n: int) -> np.ndarray:
  """The driver's own noise (ticks, 4, n): voltage [V], steering [rad], perceived offset [m], perceived speed [m/s]."""
  memories, sizes = (0.08, 0.05, 0.5, 0.1), (0.008, 0.0022, 0.008, 0.008)
  return np.stack(
    [size * coloured(rng, (ticks, n), memory) for memory, size in zip(memories, sizes, strict=True)], axis=1
  )


def hands(rng: np.random.Generator, runs: list[Manoeuvre]) -> np.ndarray:
  """The driver's noise over a session's runs (longest, 4, n), as `shaking`; a step is commanded by the software."""
  noise = shaking(rng, max(run.ticks for run in runs), len(runs))
  noise[:, 1, [run.kind in AUTOMATED for run in runs]] = 0.0
  noise[:, 0, [run.kind in STEPS for run in runs]] = 0.0
  return noise


class Driver:
  """Turns what the car does into commands (2, N), for N manoeuvres at once."""

  def __init__(self, runs: list[Manoeuvre], noise: np.ndarray, believed: SimpleNamespace) -> None:
    """Feedback that remembers.

    `noise` (T, 4, N) from `shaking`; `believed`, (N,) each: wheelbase, speed_per_motor, volts_per_speed, volts_to_move,
    max_steering; of the drive command, which is volts or the drivetrain's own: how much of it the feedback on speed and
    the tremor move for a volt (answer, tremor), its limit and step.
    """
    longest, n = len(noise), len(runs)
    self.steer, self.volts = np.zeros((2, longest, n))
    self.speed = np.full((longest, n), np.nan)
    for column, run in enumerate(runs):
      self.steer[: run.ticks, column] = run.steer
      self.volts[: run.ticks, column] = run.volts
      self.speed[: run.ticks, column] = run.speed
    self.noise, self.believed = noise, believed
    self.follows = np.array([run.path is not None for run in runs])
    self.path = stack_paths([run.path for run in runs])
    self.travelled, self.windup, self.answer = np.zeros(n), np.zeros(n), np.zeros(n)
    self.column = np.arange(n)

  def commands(self, k: int, x: np.ndarray, y: np.ndarray, yaw: np.ndarray, motor: np.ndarray) -> np.ndarray:
    """Voltage [V] and steering [rad] from tick k to the next, (2, N), by pose [m, m, rad] and motor speed [rad/s]."""
    tremor_v, tremor_s, offset, slip = self.noise[k]
    speed = motor * self.believed.speed_per_motor
    steer = self.steer[k] + self._follow(x, y, yaw, speed, offset) + tremor_s
    volts = self._hold(self.speed[k], speed + slip, self.volts[k]) + self.believed.tremor * tremor_v * (
      (self.volts[k] != 0) | ~np.isnan(self.speed[k])
    )
    limit = self.believed.max_steering
    most, least = self.believed.limit, self.believed.step
    volts, steer = np.clip(volts, -most, most), np.clip(steer, -limit, limit)
    return np.stack([np.round(volts / least) * least, np.round(steer / ANGLE_STEP) * ANGLE_STEP])

  def _hold(self, wish: np.ndarray, speed: np.ndarray, volts: np.ndarray) -> np.ndarray:
    """Proportional-integral speed control on top of the command believed to be needed."""
    holding = ~np.isnan(wish)
    error = np.where(holding, wish - speed, 0.0)
    self.windup = np.clip(self.windup + 1.2 * error * PERIOD, -1.0, 1.0)
    wanted = np.where(holding, wish, 0.0)
    guess = self.believed.volts_per_speed * wanted + self.believed.volts_to_move * np.sign(wanted)
    return np.where(holding, guess + self.believed.answer * 0.9 * error + self.believed.answer * self.windup, volts)

  def _follow(self, x: np.ndarray, y: np.ndarray, yaw: np.ndarray, speed: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Curvature ahead, plus feedback on offset and heading, through the driver's reaction time."""
    if not self.follows.any():
      return np.zeros(len(x))
    path, column = self.path, self.column
    last = path.x.shape[0] - 1
    here = np.clip((self.travelled / SPACING).astype(int), 0, last)
    heading = path.yaw[here, column]
    cos, sin = np.cos(heading), np.sin(heading)
    off_x, off_y = x - path.x[here, column], y - path.y[here, column]
    self.travelled = np.maximum(self.travelled + np.clip(off_x * cos + off_y * sin, -0.1, 0.1), 0.0)
    aside = off_y * cos - off_x * sin + offset
    turn = np.angle(np.exp(1j * (yaw - heading)))
    ahead = np.clip(here + ((0.12 + REACTION) * np.abs(speed) / SPACING).astype(int), 0, last)
    wish = (
      np.arctan(self.believed.wheelbase * path.curvature[ahead, column] * (1 + 0.03 * speed**2))
      - 0.9 * aside
      - 0.6 * turn
    )
    self.answer += (wish - self.answer) * (1 - np.exp(-PERIOD / REACTION))
    return np.where(self.follows, self.answer, 0.0)


def stack_paths(paths: list[Path | None]) -> SimpleNamespace:
  """Paths side by side, (longest, N) each, ends held; a missing path is a point at the origin."""
  none = Path(*np.zeros((4, 1)))
  chosen = [path or none for path in paths]
  longest = max(len(path.x) for path in chosen)

  def column(name: str) -> np.ndarray:
    return np.stack([np.pad(getattr(path, name), (0, longest - len(path.x)), mode="edge") for path in chosen], axis=1)

  return SimpleNamespace(**{name: column(name) for name in ("x", "y", "yaw", "curvature")})
