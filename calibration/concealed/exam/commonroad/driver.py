"""A driver of road cars of any size: looks at a point of the line ahead, and holds the speed by feedback.

Lengths are in wheelbases L and times in sqrt(L / g), so that cars of the same dimensionless groups are driven alike.
Steering is pure pursuit (Coulter, CMU-RI-TR-92-01, 1992): delta = atan(2 L sin(alpha) / d).
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from ...laboratory.driver import ANGLE_STEP
from ...laboratory.manoeuvres import PERIOD, Manoeuvre, Path
from .numbers import GRAVITY, TENTH

_NEAR, _AHEAD = 1.5, 2.2  # wheelbases, and units of time: how far ahead the eyes are
_REACTION = 0.37  # units of time: 60 ms at 1:10
_WINDUP = 5.0  # units of time: of the integral on speed
_MOST_WINDUP = 0.3  # m/s at 1:10


class RoadDriver:
  """As the laboratory's `Driver`, of one run at a time; same arguments."""

  def __init__(self, runs: list[Manoeuvre], noise: np.ndarray, believed: SimpleNamespace) -> None:
    (self.run,) = runs
    self.noise, self.believed = noise[:, :, 0], believed
    self.long, self.time = believed.wheelbase / TENTH.base, float(np.sqrt(believed.wheelbase / GRAVITY))
    self.near, self.held, self.answer = 0, 0.0, 0.0

  def commands(self, k: int, x: np.ndarray, y: np.ndarray, yaw: np.ndarray, motor: np.ndarray) -> np.ndarray:
    """Motor current and steering [rad] from tick k to the next (2, 1), by pose [m, m, rad] and motor speed [rad/s]."""
    b, (tremor_u, tremor_s, aside, slip) = self.believed, self.noise[k]
    speed = float(motor[0]) * b.speed_per_motor + slip * np.sqrt(self.long)
    steer = self.run.steer[k] + tremor_s
    if self.run.path is not None:
      steer += self._pursued(self.run.path, float(x[0]), float(y[0]), float(yaw[0]), speed, aside * self.long)
    wish = self.run.speed[k]
    drive = self.run.volts[k] if np.isnan(wish) else self._held(wish, speed)
    drive = np.clip(drive + b.tremor * tremor_u, -b.limit, b.limit)
    steer = np.clip(steer, -b.max_steering, b.max_steering)
    return np.array([[np.round(drive / b.step) * b.step], [np.round(steer / ANGLE_STEP) * ANGLE_STEP]])

  def _held(self, wish: float, speed: float) -> float:
    """Proportional-integral, on top of the current believed to be needed."""
    error = wish - speed
    most = _MOST_WINDUP * np.sqrt(self.long)
    self.held = float(np.clip(self.held + error * PERIOD / (_WINDUP * self.time), -most, most))
    return (
      self.believed.volts_per_speed * wish + self.believed.volts_to_move + self.believed.answer * (error + self.held)
    )

  def _pursued(self, path: Path, x: float, y: float, yaw: float, speed: float, aside: float) -> float:
    """The angle to the point ahead, through the driver's reaction time."""
    away = lambda i: np.hypot(path.x[i] - x, path.y[i] - y)
    last = len(path.x) - 1
    while self.near < last and away(self.near + 1) <= away(self.near):
      self.near += 1
    base = self.believed.wheelbase
    reach, ahead = _NEAR * base + _AHEAD * self.time * abs(speed), self.near
    while ahead < last and away(ahead) < reach:
      ahead += 1
    bearing = np.arctan2(path.y[ahead] - y, path.x[ahead] - x) - yaw
    wish = np.arctan(2.0 * base * (np.sin(bearing) - aside / reach) / max(away(ahead), 0.5 * reach))
    self.answer += float(wish - self.answer) * (1.0 - np.exp(-PERIOD / (_REACTION * self.time)))
    return self.answer
