"""What the sensors make of the fine history: IMU, encoder edges, absolute pose with its quality score."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..laboratory.driver import coloured
from ..laboratory.manoeuvres import PERIOD
from .simulation import TRACE, Simulation

FINE = 5  # rows of the trace per control period
EDGES = 4 * 720  # encoder counts per turn of the motor
WINDOW = 2  # rows (4 ms) over which encoder edges are differenced
POSE_EVERY = 10  # ticks
RESOLUTION = {
    "motor_voltage": 4, "motor_duty": 5, "motor_current": 3, "speed_command": 4, "steering_command": 5,
    "motor_speed": 2, "accel_x": 3, "accel_y": 3, "yaw_rate": 4,
    "pose_x": 4, "pose_y": 4, "pose_yaw": 4, "pose_score": 3,
}  # fmt: skip  # decimals written


@dataclass(frozen=True)
class Sensors:
  """How a session's sensors are logged. `pose_every`, `speed_every`: ticks between samples; `pose_noise`: factor on the
  localisation's errors; `speed_late`: s by which the encoder's value is old."""

  pose_every: int = POSE_EVERY
  pose_noise: float = 1.0
  speed_every: int = 1
  speed_late: float = 0.0

  @property
  def every(self) -> dict[str, int]:
    """Channel -> ticks between its samples, where that is not each."""
    poses = {name: self.pose_every for name in RESOLUTION if name.startswith("pose")}
    return poses | {"motor_speed": self.speed_every}

  def described(self) -> dict[str, float]:
    """For the truth file."""
    return {"pose_every": self.pose_every, "pose_noise": self.pose_noise, "speed_every": self.speed_every,
            "speed_late": self.speed_late}  # fmt: skip


class Log:
  """Channels on the control grid (T, N), before and after noise; `state`: the true signals (T, N) by name of TRACE."""

  def __init__(self, sim: Simulation, ticks: int) -> None:
    self.sim, self.car, self.ticks = sim, sim.car, ticks
    self.fine = sim.trace  # (FINE * ticks + 1, 11, N)
    self.time = PERIOD * np.arange(ticks)
    self.channels: dict[str, np.ndarray] = {}
    self.vibration = np.abs(self.state("vx"))
    self._read()
    for effect in sim.effects:
      effect.sense(self)

  def state(self, name: str, delay: np.ndarray | float = 0.0) -> np.ndarray:
    """True signal `delay` (T, N), (N,) or number [s] before each tick, linear between fine rows, held before start."""
    row = self.fine[:, TRACE.index(name)]
    if isinstance(delay, float) and delay == 0.0:
      return row[: FINE * self.ticks : FINE].copy()
    at = np.clip((self.time[:, None] - delay) / PERIOD * FINE, 0.0, len(row) - 1)
    low = np.minimum(at.astype(int), len(row) - 2)
    share, column = at - low, np.arange(row.shape[1])
    return (1 - share) * row[low, column] + share * row[low + 1, column]

  def _read(self) -> None:
    """Noise-free sensors with the systematic errors of the car's columns."""
    car, out = self.car, self.channels
    late = car.imu_delay
    a_x, a_y = (0.5 * (self.state(n, late) + self.state(n, late + 2e-3)) for n in ("accel_x", "accel_y"))
    cos, sin = np.cos(car.imu_twist), np.sin(car.imu_twist)
    walk = car.bias_walk * self.time[:, None]
    out["accel_x"] = cos * a_x + sin * a_y + car.accel_bias_x + walk
    out["accel_y"] = cos * a_y - sin * a_x + car.accel_bias_y - walk
    out["yaw_rate"] = (1 + car.gyro_gain) * self.state("yaw_rate", late) + car.gyro_bias
    out["motor_speed"] = self._encoder()
    late = car.pose_delay + car.pose_drift * self.time[:, None]
    yaw = self.state("yaw", late)
    ahead, aside = car.marker_x + car.pose_ahead, car.marker_y + car.pose_aside
    out["pose_x"] = self.state("x", late) + np.cos(yaw) * ahead - np.sin(yaw) * aside
    out["pose_y"] = self.state("y", late) + np.sin(yaw) * ahead + np.cos(yaw) * aside
    out["pose_yaw"] = yaw + car.pose_turn

  def _encoder(self) -> np.ndarray:
    """Edges counted over the last 4 ms; before the start the motor turned at its first speed."""
    angle = self.fine[:, TRACE.index("motor_angle")]
    first = self.fine[0, TRACE.index("motor")]
    before = angle[0] - first * 2e-3 * np.arange(WINDOW, 0, -1)[:, None]
    counts = np.floor(np.concatenate([before, angle]) * (EDGES / (2 * np.pi)))
    ticks = slice(0, FINE * self.ticks, FINE)
    return (counts[WINDOW:][ticks] - counts[:-WINDOW][ticks]) * (2 * np.pi / EDGES / (WINDOW * PERIOD / FINE))


def add_noise(
  channels: dict[str, np.ndarray], vibration: np.ndarray, level: float, rng: np.random.Generator, poses: float = 1.0
) -> dict[str, np.ndarray]:
  """Channels (T, n) of one session with noise and with `pose_score`; level 0 leaves biases and noise out; `poses` is a
  factor on what localisation errs by."""
  shape = vibration.shape
  n = shape[1]
  out = dict(channels)
  shake = np.sqrt(0.05**2 + (0.035 * vibration) ** 2)
  bias = np.repeat(rng.standard_normal((4, 1)), n, axis=1) + 0.3 * rng.standard_normal((4, n))  # session and run
  for i, name in enumerate(("accel_x", "accel_y")):
    out[name] = channels[name] + level * (shake * rng.standard_normal(shape) + 0.02 * bias[i])
  out["yaw_rate"] = channels["yaw_rate"] + level * (0.006 * rng.standard_normal(shape) + 0.0015 * bias[2])
  turning = np.tanh(np.abs(channels["motor_speed"]) / 5.0)
  out["motor_speed"] = channels["motor_speed"] + level * 0.5 * turning * rng.standard_normal(shape)
  murk = 1.0 + 0.5 * np.abs(coloured(rng, shape, 2.0))
  spike = rng.random(shape) < 0.004
  out["pose_score"] = np.clip(
    0.92 - 0.12 * level * (murk - 1) - 0.45 * (level > 0) * spike + 0.01 * level * rng.standard_normal(shape), 0.05, 1.0
  )
  for name, slow, quick, jump in (
    ("pose_x", 0.004, 0.0015, 0.08),
    ("pose_y", 0.004, 0.0015, 0.08),
    ("pose_yaw", 0.003, 0.002, 0.03),
  ):
    error = murk * (slow * coloured(rng, shape, 0.3) + quick * rng.standard_normal(shape))
    out[name] = channels[name] + poses * level * (error + spike * jump * rng.standard_normal(shape))
  return out
