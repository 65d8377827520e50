"""The cheap lidar: pose and score from the true pose and the statistics of a real one's errors."""

import dataclasses
import math

import numpy as np

from qcar_twin.sensors.base import POSE, Array, Mask, Timing
from qcar_twin.sensors.noise import ChannelNoise, ErrorStream, channel_noise
from qcar_twin.sensors.score import ScoreVariance
from qcar_twin.sensors.streams import CarStreams


@dataclasses.dataclass(frozen=True)
class StatisticalLidar:
  """Lidar pose and score without a scan: the true pose plus errors of the size the score tells.

  The score wanders (first order, log-normal); position and yaw errors have the variance of the score and
  are coloured, because a map's faults change only as the car moves on.

  Attributes:
    position, yaw: variance by score, m^2 and rad^2.
    correlation: time constant of the errors, s.
    coloured: share of the standard deviation that is coloured; the rest of the variance is white.
    score: median.  score_spread: standard deviation of its logarithm.  score_correlation: s.
    spike_chance, spike_size: per fix, m; a spike hits x and y, its score is a good one's.
  """

  timing: Timing = Timing(rate=10.0, latency=0.05, dropout=0.01)
  position: ScoreVariance = ScoreVariance.between(0.004, 0.04, 20.0, 2.0)
  yaw: ScoreVariance = ScoreVariance.between(0.004, 0.04, 20.0, 2.0)
  correlation: float = 0.3
  coloured: float = 0.9
  score: float = 80.0
  score_spread: float = 0.25
  score_correlation: float = 2.0
  spike_chance: float = 0.01
  spike_size: float = 0.5
  channels = ("pose_x", "pose_y", "pose_yaw", "pose_score")

  @classmethod
  def from_errors(cls, errors: Array, scores: Array, timing: Timing) -> "StatisticalLidar":
    """The statistics of poses whose truth is known.

    Args:
      errors: of x, y [m] and yaw [rad] over consecutive fixes, (k, 3), spikes and dropouts taken out.
      scores: (k,).
      timing: of the lidar they came from.
    """
    time = np.arange(len(errors)) / timing.rate
    parts = [channel_noise(time, errors[:, i]) for i in range(3)]
    coloured = [part for part in parts if part.coloured > 0.0]
    share = (
      min(float(np.sqrt(np.mean([(part.coloured / part.std) ** 2 for part in coloured]))), 0.99) if coloured else 0.0
    )
    logs = channel_noise(time, np.log(scores))
    return cls(
      timing=timing,
      position=ScoreVariance.fit(np.tile(scores, 2), errors[:, :2].T.ravel()),
      yaw=ScoreVariance.fit(scores, errors[:, 2]),
      correlation=float(np.mean([part.correlation for part in coloured])) if coloured else 1.0,
      coloured=share,
      score=float(np.exp(np.median(np.log(scores)))),
      score_spread=float(np.std(np.log(scores))),
      score_correlation=logs.correlation if logs.coloured > 0.0 else 0.01,
      spike_chance=0.0,
    )

  def begin(self, count: int, period: float, rng: np.random.Generator | CarStreams) -> "StatisticalLidarRun":
    """Put it to work in N cars."""
    return StatisticalLidarRun(self, count, rng)


class StatisticalLidarRun:
  """The cheap lidar of N cars under way."""

  def __init__(self, lidar: StatisticalLidar, count: int, rng: np.random.Generator | CarStreams):
    self._lidar = lidar
    interval = 1.0 / lidar.timing.rate
    white = math.sqrt(1.0 - lidar.coloured**2)
    error = ChannelNoise(white=white, coloured=lidar.coloured, correlation=lidar.correlation)
    score = ChannelNoise(coloured=lidar.score_spread, correlation=lidar.score_correlation)
    self._errors = ErrorStream((error, error, error, score), count, interval, rng)
    self._rng = rng

  def observe(self, signals: Array) -> None:
    """Nothing to remember between samples."""

  def sample(self, signals: Array) -> Array:
    """pose_x, pose_y, pose_yaw, pose_score, (N, 4)."""
    lidar, errors = self._lidar, self._errors.sample()
    score = lidar.score * np.exp(errors[:, 3])
    std = np.sqrt(np.stack([lidar.position.of(score), lidar.position.of(score), lidar.yaw.of(score)], axis=-1))
    pose = signals[:, POSE] + std * errors[:, :3]
    lots = self._rng.random((2, len(score)))
    angle, hit = 2.0 * np.pi * lots[1], lots[0] < lidar.spike_chance
    pose[:, 0] += np.where(hit, lidar.spike_size * np.cos(angle), 0.0)
    pose[:, 1] += np.where(hit, lidar.spike_size * np.sin(angle), 0.0)
    return np.concatenate([pose, score[:, None]], axis=1)

  def restart(self, which: Mask, signals: Array) -> None:
    """New errors for some cars."""
    self._errors.restart(which)
