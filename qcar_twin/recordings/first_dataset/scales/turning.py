"""How a car turned under its steering: at small slip yaw rate = speed * tan(angle) / wheelbase."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.completed import heading_or_course
from qcar_twin.recordings.first_dataset.scales.series import correlation
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

STEEPEST = 1.2  # rad, where the tangent is still tame
_BIN = 0.25  # s, over which speed, command and turning are compared
_LAGS = np.arange(0.0, 0.45, 0.05)  # s, of the turning behind the command: a servo's 0.1 and a clock's
_GENTLE = 2.0  # m/s^2 across, below which a car of this size goes where its wheels point
_SOLVED = 40  # repetitions, after which the scale of an angle below 45 deg is solved to the last digit that counts
_TOLD_APART = 0.9  # squared cosine between the turning by the angle and by a trim, up to which both are told
_TRIM, _LEAST = 0.35, 10  # of the largest command, beyond which it is a neutral and no trim; bins that tell any
_BOTH_SIDES = 0.1  # of the turning to the other side, squared, from which a trim is told from a servo's curve


@dataclass(frozen=True)
class Turning:
  """What a car did in bins, (k,) each.

  Attributes:
    speed: m/s.
    angle: commanded from its trim on, rad, as long before the turning as makes the two go together best: servos and
      clocks lag.
    turned: yaw rate, rad/s.
  """

  speed: Array
  angle: Array
  turned: Array

  @classmethod
  def of(cls, recordings: Sequence[Recording], radius: float = 1.0) -> Turning:
    """`radius`: rolling radius of the wheels over the motor's angle, m, for logs without a speed."""
    each = [cls._at(recordings, radius, lag) for lag in _LAGS]
    return max(each, key=lambda one: abs(one.alike()))

  @classmethod
  def _at(cls, recordings: Sequence[Recording], radius: float, lag: float) -> Turning:
    """The same for a lag of the turning behind the command, s."""
    binned = [each for r in recordings if (each := _binned(r, radius, lag)) is not None]
    read = cls(*np.concatenate([np.empty((3, 0)), *binned], axis=1))
    return cls(read.speed, read.angle - _trim(*read.gently), read.turned)

  @property
  def gently(self) -> tuple[Array, Array, Array]:
    """Speed, angle and yaw rate where the car turned gently."""
    there = np.abs(self.speed * self.turned) < _GENTLE
    return self.speed[there], self.angle[there], self.turned[there]

  def alike(self, least: int = 2) -> float:
    """Correlation of the turning with what the steering asked for, where the car turned gently or in all bins, the
    larger: a car that was driven hard turned gently only where its servo lagged."""
    speed, angle, turned = self.gently
    gently, at_all = correlation(speed * angle, turned, least), correlation(self.speed * self.angle, self.turned, least)
    return max(gently, at_all, key=abs)

  def ratio(self, wheelbase: float) -> float:
    """Least squares k > 0 of yaw rate = +-speed tan(k angle) / wheelbase, where a car so steered turns gently, by
    repeated scaling, which runs away where no k does.

    Which bins are gentle goes by what was asked for. By how the car turned they would be those in which it lagged
    behind a large angle, and of a slalom k would come out half as large.
    """
    speed, angle, turned = self.gently
    ratio = _scaled(1.0, speed / wheelbase, angle, turned, np.ones(speed.size, dtype=bool))
    rate = self.speed / wheelbase
    for _ in range(_SOLVED):
      asked = self.speed * rate * np.tan(np.clip(ratio * self.angle, -STEEPEST, STEEPEST))
      gentle = np.abs(asked) < _GENTLE
      if np.count_nonzero(gentle & (asked != 0.0)) < _LEAST:
        break
      ratio = _scaled(ratio, rate, self.angle, self.turned, gentle)
    return ratio


def _scaled(ratio: float, rate: Array, angle: Array, turned: Array, there: NDArray[np.bool_]) -> float:
  """The ratio by which these bins are better fitted, after as many steps of scaling as solve it."""
  rate, angle, turned = rate[there], angle[there], turned[there]
  for _ in range(_SOLVED):
    expected = rate * np.tan(np.clip(ratio * angle, -STEEPEST, STEEPEST))
    ratio *= abs(float(expected @ turned / (expected @ expected)))
  return ratio


def _trim(rate: Array, angle: Array, turning: Array) -> float:
  """The angle that the car goes straight on with, rad, by least squares of turning = rate k (angle - trim); 0 where the
  car hardly turned to both sides: a servo that is not linear looks so, too."""
  turned = rate * angle
  apart = (rate @ rate) * (turned @ turned) - (rate @ turned) ** 2
  sides = np.sort([np.sum(turning[turning * rate * side > 0.0] ** 2) for side in (-1.0, 1.0)])
  if rate.size < _LEAST or not apart > (1.0 - _TOLD_APART) * (rate @ rate) * (turned @ turned):
    return 0.0
  k, straight = np.linalg.lstsq(np.stack([turned, rate], axis=1), turning, rcond=None)[0]
  trim = -straight / k if k != 0.0 else math.inf
  return float(trim) if sides[0] > _BOTH_SIDES * sides[1] and abs(trim) < _TRIM * np.abs(angle).max() else 0.0


def _binned(recording: Recording, radius: float, lag: float) -> Array | None:
  """Speed, command a lag before [s] and yaw rate, (3, k); None where one of them was not logged."""
  edges = recording.start + _BIN * np.arange(int(recording.duration / _BIN) + 1)
  middle = 0.5 * (edges[1:] + edges[:-1])
  if "steering_command" not in recording or middle.size == 0:
    return None
  if "yaw_rate" in recording:
    turn = recording["yaw_rate"].interpolate(middle)
  elif (heading := heading_or_course(recording)) is not None:
    turn = np.diff(heading.interpolate(edges)) / _BIN
  else:
    return None
  wheels = "speed" not in recording
  speed = recording["motor_speed" if wheels else "speed"].interpolate(middle) * (radius if wheels else 1.0)
  angle = recording["steering_command"].at(middle - lag)
  there = np.isfinite(turn) & np.isfinite(speed)
  return np.stack([speed, angle, turn])[:, there]
