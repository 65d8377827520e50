"""Whether a car's gyro has a bias: the last fixes against odometry, by least squares.

Odometry (gyro, speed, sideslip) and the fixes of some seconds differ by a place, a turn, and by what is wrong:

  yaw_k  = Theta_k + c - b (t_k - t) - tau r_k
  p_k    = p + (1 + kappa) o_k + psi J o_k - b B_k - tau v_k e_k

with the gyro's bias b, rad/s, the scale kappa of the speed, an error tau of the stamps, s, the turns c and psi of yaw
and course, and B_k what a drifting heading does to the odometry's place o_k. The filter's own innovations tell little
of it: it follows a steady error. Linear in all seven unknowns, coloured errors whitened; a finding is an estimate of b
away from the one held by more standard deviations than a stated error rate allows, as in the integrity monitoring of
satellite navigation (Parkinson and Axelrad, Navigation 35(2), 1988). Stamps are judged elsewhere (`StampWatch`): at the
speeds of a small car 50 ms hide in the errors of the fixes for many seconds.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

Array = NDArray[np.float64]
WINDOWS = (8, 16, 40)  # last fixes that are compared: short for what is large, long for what is small
GAP = 1.0  # s without a fix after which the comparison begins anew
FALSE_ALARM = 1e-6  # probability of a finding where there is nothing, per fix
MISSED = 0.05  # probability of not finding the bias behind `unseen` within its window
LIMIT = float(norm.isf(0.5 * FALSE_ALARM / len(WINDOWS)))  # shared by the tests made at each fix
SURE = LIMIT + float(norm.isf(MISSED))
PRIOR = (10.0, 10.0, 0.3, 0.3, 1.0, 0.05, 0.03)  # p m, m; psi, c rad; b rad/s; tau s; kappa: standard deviations
TRUST = np.diag(1.0 / np.square(PRIOR))
BIAS, DELAY, SCALE = 4, 5, 6  # rows of the unknowns


class Finding(NamedTuple):
  """A bias that has been found, or found more exactly.

  Attributes:
    bias: by how much it has changed, rad/s.
    span: s that the comparison covers: the filter has gone wrong for no longer.
  """

  bias: float
  span: float


@dataclasses.dataclass(slots=True)
class OdometryWatch:
  """One car's odometry, the last fixes beside it, and what is held against the gyro.

  Attributes:
    turned: integral of the gyro, rad.  place: of speed along the course, m.  moment: of time times it, m s.
    rows: of each fix: time, x, y, yaw, 1/std of place and yaw, and place, turned, moment, speed, course, rate then.
    bias: of the gyro, rad/s.
    since: fixes since it was found, while it is still made more exact; -1 for none.
    unseen: rad by which a bias turns the yaw that one of the windows would hardly miss, in its span.
  """

  turned: float = 0.0
  place: tuple[float, float] = (0.0, 0.0)
  moment: tuple[float, float] = (0.0, 0.0)
  rows: tuple[tuple[float, ...], ...] = ()
  bias: float = 0.0
  since: int = -1
  unseen: float = 0.0

  def copy(self) -> "OdometryWatch":
    """An independent copy."""
    return dataclasses.replace(self)

  def travel(self, time: float, speed: float, sideslip: float, rate: float, period: float) -> None:
    """A period that ended at `time`, s, at a speed, m/s, a sideslip, rad, and the gyro's rate, rad/s."""
    course = self.turned + sideslip + 0.5 * rate * period
    dx, dy = period * speed * math.cos(course), period * speed * math.sin(course)
    self.turned += rate * period
    self.place = self.place[0] + dx, self.place[1] + dy
    self.moment = self.moment[0] + time * dx, self.moment[1] + time * dy

  def compare(
    self,
    time: float,
    pose: tuple[float, float, float],
    stds: tuple[float, float],
    motion: tuple[float, float, float],
    correlation: float,
  ) -> Finding | None:
    """Take an accepted fix, m, m, rad, its standard deviations, m and rad, and the motion at its time.

    Args:
      motion: speed, m/s, sideslip, rad, yaw rate, rad/s.
      correlation: time constant of the fixes' errors, s; 0 for white ones.
    """
    if self.rows and not 0.0 < time - self.rows[-1][0] < GAP:
      self.rows, self.since = (), -1
    speed, sideslip, rate = motion
    known = *self.place, self.turned, *self.moment, speed, self.turned + sideslip, rate
    self.rows = (*self.rows[1 - WINDOWS[-1] :], (time, *pose, 1.0 / stds[0], 1.0 / stds[1], *known))
    if len(self.rows) < WINDOWS[0]:
      return None
    equations = differences(np.array(self.rows), correlation)
    return self._news(*equations) or self._refined(*equations)

  def _news(self, design: Array, seen: Array) -> Finding | None:
    """Whether the bias has changed: the surest of the tests."""
    surest, chosen, count, hidden = LIMIT, None, len(self.rows), []
    for window in {min(window, count) for window in WINDOWS}:
      value, spread = bias_of(design[:, -window:], seen[:, -window:], self.bias)
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
    value, _ = bias_of(design[:, -window:], seen[:, -window:], self.bias)
    if self.since >= WINDOWS[-1]:
      self.since = -1
    return self._taken(value)

  def _taken(self, value: float) -> Finding:
    change, self.bias = value - self.bias, value
    return Finding(change, self.rows[-1][0] - self.rows[0][0])


def differences(rows: Array, correlation: float) -> tuple[Array, Array]:
  """Slopes (3, k, 7) and values (3, k) of the whitened equations of k fixes with odometry beside them, (k, 14)."""
  time, x, y, yaw, sharp, keen, ox, oy, turned, mx, my, speed, course, rate = rows.T
  apart = yaw - turned
  offset = math.atan2(np.sin(apart).sum(), np.cos(apart).sum())
  cos, sin = math.cos(offset), math.sin(offset)
  middle = time.mean()
  ox, oy, mx, my = (a - a.mean() for a in (ox, oy, mx - middle * ox, my - middle * oy))
  ox, oy, mx, my = cos * ox - sin * oy, sin * ox + cos * oy, cos * mx - sin * my, sin * mx + cos * my
  ahead = course + offset
  design, seen = np.zeros((3, len(time), len(PRIOR))), np.empty((3, len(time)))
  design[0, :, 0] = design[1, :, 1] = design[2, :, 3] = 1.0
  design[:2, :, 2] = -oy, ox
  design[:, :, BIAS] = my, -mx, middle - time
  design[:, :, DELAY] = -speed * np.cos(ahead), -speed * np.sin(ahead), -rate
  design[:2, :, SCALE] = ox, oy
  seen[0], seen[1] = x - x.mean() - ox, y - y.mean() - oy
  seen[2] = np.remainder(apart - offset + math.pi, math.tau) - math.pi
  weight = np.stack([sharp, sharp, keen])
  design *= weight[:, :, None]
  seen *= weight
  if correlation > 0.0:
    memory = np.exp(-np.diff(time) / correlation)
    rest = np.sqrt(1.0 - memory**2)
    design[:, 1:] = (design[:, 1:] - memory[:, None] * design[:, :-1]) / rest[:, None]
    seen[:, 1:] = (seen[:, 1:] - memory * seen[:, :-1]) / rest
  return design, seen


def bias_of(design: Array, seen: Array, held: float) -> tuple[float, float]:
  """The gyro's bias, rad/s, and its standard deviation, no less than residuals say.

  Args:
    design, seen: of `differences`.
    held: rad/s, what it is taken for.
  """
  design, seen = design.reshape(-1, len(PRIOR)), seen.ravel()
  expected = np.zeros(len(PRIOR))
  expected[BIAS] = held
  covariance = np.linalg.inv(design.T @ design + TRUST)
  found = expected + covariance @ (design.T @ (seen - design @ expected))
  residuals = seen - design @ found
  excess = max(1.0, float(residuals @ residuals) / (len(seen) - len(PRIOR)))
  return float(found[BIAS]), math.sqrt(excess * covariance[BIAS, BIAS])
