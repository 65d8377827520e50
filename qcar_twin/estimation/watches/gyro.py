"""Whether a car's gyro is wrong: the yaw of the last fixes against the integral of the gyro, by least squares.

  yaw_k - Theta_k = c - b (t_k - t) - tau r_k

with the turn Theta_k that the gyro tells, an unknown start c, the gyro's bias b, rad/s, and an error tau of the stamps,
s, that must not pass for one. The filter's own innovations tell little of it: it follows a steady error. No model of
the car enters, so that slip and sideslip cannot be taken for a bias. Linear in the unknowns, coloured errors whitened;
a finding is an estimate of b away from the one held by more standard deviations than a stated error rate allows, as in
the integrity monitoring of satellite navigation (Parkinson and Axelrad, Navigation 35(2), 1988).

A gyro that is off by so much that no bias can be fitted in time is left out as soon as two raw fixes in a row turn
otherwise than it does. What the filter's gate thinks of the gyro is no evidence here: the gate is the model's view.
"""

import copy
import dataclasses
import math
import statistics
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

Array = NDArray[np.float64]
WINDOWS = (8, 16, 40)  # last fixes that are compared: short for what is large, long for what is small
HOLD = 0.1  # s that a rate of the gyro is held
CONTRADICTIONS = 2  # turns between raw fixes in a row, each FALSE_ALARM likely by chance, that contradict the gyro
AGREEMENTS = 10  # turns in a row with which a gyro that was left out is taken back, a second of lidar
GAP = 1.0  # s without a fix after which the comparison begins again
FALSE_ALARM = 1e-6  # probability of a finding where there is nothing, per fix
MISSED = 0.05  # probability of not finding the bias behind `unseen` within its window
LIMIT = float(norm.isf(0.5 * FALSE_ALARM / len(WINDOWS)))  # shared by the tests made at each fix
SURE = LIMIT + float(norm.isf(MISSED))
BIAS, UNKNOWNS = 1, 3  # c, b, tau
STAMPS = 0.05  # s, standard deviation of what stamps are trusted with
TRUST = np.diag([0.0, 1.0, 1.0 / STAMPS**2])  # b within 1 rad/s and tau within 50 ms, a standard deviation each


class Finding(NamedTuple):
  """A bias that has been detected, or estimated more exactly.

  Attributes:
    bias: by how much it has changed, rad/s.
    span: s that the comparison covers: the filter has gone wrong for no longer.
  """

  bias: float
  span: float


@dataclasses.dataclass(slots=True)
class GyroWatch:
  """One car's gyro, the last fixes, and the bias that they show.

  Attributes:
    turned: integral of the gyro, rad.  rate: its last rate, rad/s.  silent: since then, s.
    recent: its last two rates, rad/s, without spikes.
    rows: of each fix: time s, yaw rad, its standard deviation rad, and `turned` and yaw rate rad/s then.
    bias: of the gyro, rad/s.
    since: fixes since it was detected, while it is still made more exact; -1 for none.
    unseen: rad by which a bias turns the yaw that one of the windows would hardly miss, in its span.
    last: time s, yaw rad, `turned` and rate at the last raw fix.
    contrary: turns between raw fixes in a row that contradict it, by their sign.  agreements: in a row that do not.
    doubted: whether it is left out.
  """

  turned: float = 0.0
  rate: float = 0.0
  recent: tuple[float, ...] = ()
  silent: float = math.inf
  rows: tuple[tuple[float, ...], ...] = ()
  bias: float = 0.0
  since: int = -1
  unseen: float = 0.0
  last: tuple[float, ...] = ()
  contrary: int = 0
  agreements: int = 0
  doubted: bool = False

  def copy(self) -> "GyroWatch":
    """An independent copy."""
    return copy.copy(self)

  def travel(self, rate: float, period: float, std: float) -> None:
    """A period, s, with a rate of the gyro, rad/s, whatever the filter thinks of it; NaN for none.

    A rate further than `LIMIT` standard deviations `std`, rad/s, from both its neighbours' is a spike: their median
    stands for it. A missing one is the last, for `HOLD`; longer silence ends the comparison.
    """
    self.silent = 0.0 if math.isfinite(rate) else self.silent + period
    if self.silent > HOLD:
      self.rows, self.last, self.recent, self.since = (), (), (), -1
      return
    rate = rate if math.isfinite(rate) else self.rate
    before, self.recent = self.recent, (*self.recent[-1:], rate)
    if len(before) == 2:
      settled = statistics.median((*before, rate))
      if abs(before[1] - settled) > LIMIT * std:
        self.turned += period * (settled - self.rate)
        self.recent = settled, rate
    self.rate = rate
    self.turned += period * rate

  def witness(self, time: float, yaw: float, std: float) -> float:
    """Take a raw fix at a time, s: its yaw and standard deviation, rad.

    Returns:
      The turn, rad, by which the gyro has just been found to be wrong; zero where nothing is new.
    """
    before, self.last = self.last, (time, yaw, self.turned, self.rate)
    if self.silent > HOLD:
      self.last = ()
    if not (before and self.last and 0.0 < time - before[0] < GAP):
      return 0.0
    span = time - before[0]
    apart = math.remainder(yaw - before[1] - (self.turned - before[2]) + self.bias * span, math.tau)
    slack = LIMIT * math.hypot(math.sqrt(2.0) * std, STAMPS * (self.rate - before[3]))
    if abs(apart) <= slack:
      self.contrary, self.agreements = 0, self.agreements + 1
      self.doubted = self.doubted and self.agreements < AGREEMENTS
      return 0.0
    again = abs(self.contrary) + 1 if self.contrary * apart > 0.0 else 1
    self.contrary, self.agreements = int(math.copysign(again, apart)), 0
    if self.doubted or abs(self.contrary) < CONTRADICTIONS:
      return 0.0
    self.doubted = True
    return CONTRADICTIONS * apart

  def compare(self, time: float, yaw: float, std: float, rate: float, correlation: float) -> Finding | None:
    """Take an accepted fix at a time, s: its yaw, rad, standard deviation, rad, and the yaw rate then, rad/s.

    Args:
      correlation: time constant of the fixes' errors, s; 0 for white ones.
    """
    if self.silent > HOLD:
      return None
    if self.rows and not 0.0 < time - self.rows[-1][0] < GAP:
      self.rows, self.since = (), -1
    self.rows = (*self.rows[1 - WINDOWS[-1] :], (time, yaw, std, self.turned, rate))
    if len(self.rows) < WINDOWS[0]:
      return None
    equations = differences(np.array(self.rows), correlation)
    return self._news(*equations) or self._refined(*equations)

  def _news(self, design: Array, seen: Array) -> Finding | None:
    """Whether the bias has changed: the surest of the tests."""
    surest, chosen, count, hidden = LIMIT, None, len(self.rows), []
    for window in {min(window, count) for window in WINDOWS}:
      value, spread = bias_of(design[-window:], seen[-window:], self.bias)
      if abs(value - self.bias) > surest * spread:
        surest, chosen = abs(value - self.bias) / spread, (value, window)
      hidden.append(SURE * spread * (self.rows[-1][0] - self.rows[-window][0]))
    self.unseen = min(hidden)
    if chosen is None:
      return None
    value, window = chosen
    self.since, self.rows = 0, self.rows[-window:]
    return self._taken(value)

  def _refined(self, design: Array, seen: Array) -> Finding | None:
    """What has been found, from the fixes since."""
    if self.since < 0:
      return None
    self.since += 1
    window = max(WINDOWS[0], self.since)
    value, _ = bias_of(design[-window:], seen[-window:], self.bias)
    if self.since >= WINDOWS[-1]:
      self.since = -1
    return self._taken(value)

  def _taken(self, value: float) -> Finding:
    change, self.bias = value - self.bias, value
    return Finding(change, self.rows[-1][0] - self.rows[0][0])


def differences(rows: Array, correlation: float) -> tuple[Array, Array]:
  """Slopes (k, 3) and values (k,) of the whitened equations of k fixes, (k, 5)."""
  time, yaw, std, turned, rate = rows.T
  apart = np.unwrap(yaw - turned)
  design = np.stack([np.ones_like(time), time.mean() - time, -rate], axis=-1) / std[:, None]
  seen = (apart - apart.mean()) / std
  if correlation > 0.0:
    memory = np.exp(-np.diff(time) / correlation)
    rest = np.sqrt(1.0 - memory**2)
    design[1:] = (design[1:] - memory[:, None] * design[:-1]) / rest[:, None]
    seen[1:] = (seen[1:] - memory * seen[:-1]) / rest
  return design, seen


def bias_of(design: Array, seen: Array, held: float) -> tuple[float, float]:
  """The gyro's bias, rad/s, and its standard deviation, no less than residuals say.

  Args:
    design, seen: of `differences`.
    held: rad/s, what it is taken for.
  """
  expected = np.array([0.0, held, 0.0])
  covariance = np.linalg.inv(design.T @ design + TRUST)
  posterior = expected + covariance @ (design.T @ (seen - design @ expected))
  residuals = seen - design @ posterior
  excess = max(1.0, float(residuals @ residuals) / (len(seen) - UNKNOWNS))
  return float(posterior[BIAS]), math.sqrt(excess * covariance[BIAS, BIAS])
