"""Whether a car's gyro has a bias and its fixes a wrong stamp: the last fixes against odometry, by least squares.

Odometry (gyro, speed, sideslip) and the fixes of some two seconds differ by a place, a turn, and by what is wrong:

  yaw_k  = Theta_k + c - b (t_k - t) - tau r_k
  p_k    = p + (1 + kappa) o_k + psi J o_k - b B_k - tau v_k e_k

with the gyro's bias b, rad/s, the fixes' lateness beyond their stamps tau, s (a fix is of the pose tau before its
stamp), the scale kappa of the speed, the turns c and psi of yaw and course, and B_k what a drifting heading does to
the odometry's place o_k. The filter's own innovations tell little of either: it follows a steady error. Linear in all
seven unknowns; a finding is a normalised estimate beyond the normal quantile of a stated error rate, as in the
integrity monitoring of satellite navigation (Parkinson and Axelrad, Navigation 35(2), 1988).
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
LIMIT = float(norm.isf(0.5 * FALSE_ALARM / (2 * len(WINDOWS))))  # shared by the tests made at each fix
FREE = (10.0, 10.0, 0.3, 0.3, 1.0, 0.2, 0.03)  # p m, m; psi, c rad; b rad/s; tau s; kappa: standard deviations
HELD = {4: 0.01, 5: 0.005}  # of b and tau while the other is in question: one fault at a time
BIAS, DELAY = 4, 5  # rows of the unknowns


class Finding(NamedTuple):
  """A sensor error that has been found, or found more exactly.

  Attributes:
    bias: by how much the gyro's has changed, rad/s.  delay: likewise the fixes', s.
    span: s that the comparison covers: the filter has gone wrong for no longer.
  """

  bias: float
  delay: float
  span: float


@dataclasses.dataclass(slots=True)
class OdometryWatch:
  """One car's odometry, the last fixes beside it, and what is held against gyro and stamps.

  Attributes:
    turned: integral of the gyro, rad.  place: of speed along the course, m.  moment: of time times it, m s.
    rows: of each fix: time, x, y, yaw, 1/std of place and yaw, and place, turned, moment, speed, course, rate then.
    bias: of the gyro, rad/s.  delay: of the fixes beyond their stamps, s.
    changed: which of the two (BIAS, DELAY) has been found and is still made more exact; 0 for none.
    since: fixes since it was found.
  """

  turned: float = 0.0
  place: tuple[float, float] = (0.0, 0.0)
  moment: tuple[float, float] = (0.0, 0.0)
  rows: tuple[tuple[float, ...], ...] = ()
  bias: float = 0.0
  delay: float = 0.0
  changed: int = 0
  since: int = 0

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
      self.rows, self.changed = (), 0
    speed, sideslip, rate = motion
    known = *self.place, self.turned, *self.moment, speed, self.turned + sideslip, rate
    self.rows = (*self.rows[1 - WINDOWS[-1] :], (time, *pose, 1.0 / stds[0], 1.0 / stds[1], *known))
    if len(self.rows) < WINDOWS[0]:
      return None
    rows = np.array(self.rows)
    if self.changed:
      self.since += 1
    return self._news(rows, correlation) or self._refined(rows, correlation)

  def _news(self, rows: Array, correlation: float) -> Finding | None:
    """Whether something has changed: the surest of the tests."""
    best, chosen, estimate, size = LIMIT, 0, 0.0, 0
    for window in {min(window, len(rows)) for window in WINDOWS}:
      problem = differences(rows[-window:], correlation)
      for which, held in ((BIAS, self.bias), (DELAY, self.delay)):
        value, spread = solved(*problem, which, (self.bias, self.delay))
        if abs(value - held) > best * spread:
          best, chosen, estimate, size = abs(value - held) / spread, which, value, window
    if not chosen:
      return None
    self.changed, self.since = chosen, 0
    self.rows = self.rows[-size:]
    return self._taken(chosen, estimate)

  def _refined(self, rows: Array, correlation: float) -> Finding | None:
    """What has been found, from the fixes since."""
    if not self.changed:
      return None
    which, window = self.changed, max(WINDOWS[0], self.since)
    value, _ = solved(*differences(rows[-window:], correlation), which, (self.bias, self.delay))
    if self.since >= WINDOWS[-1]:
      self.changed = 0
    return self._taken(which, value)

  def _taken(self, which: int, value: float) -> Finding:
    span = self.rows[-1][0] - self.rows[0][0]
    if which == BIAS:
      found = Finding(value - self.bias, 0.0, span)
      self.bias = value
    else:
      found = Finding(0.0, value - self.delay, span)
      self.delay = value
    return found


def differences(rows: Array, correlation: float) -> tuple[Array, Array]:
  """Slopes (3 k, 7) and values (3 k,) of the whitened equations of k fixes with odometry beside them, (k, 14)."""
  time, x, y, yaw, sharp, keen, ox, oy, turned, mx, my, speed, course, rate = rows.T
  apart = yaw - turned
  offset = math.atan2(np.sin(apart).sum(), np.cos(apart).sum())
  cos, sin = math.cos(offset), math.sin(offset)
  middle = time.mean()
  ox, oy, mx, my = (a - a.mean() for a in (ox, oy, mx - middle * ox, my - middle * oy))
  ox, oy, mx, my = cos * ox - sin * oy, sin * ox + cos * oy, cos * mx - sin * my, sin * mx + cos * my
  ahead = course + offset
  design, seen = np.zeros((3, len(time), 7)), np.empty((3, len(time)))
  design[0, :, 0] = design[1, :, 1] = design[2, :, 3] = 1.0
  design[:2, :, 2] = -oy, ox
  design[:, :, BIAS] = my, -mx, middle - time
  design[:, :, DELAY] = -speed * np.cos(ahead), -speed * np.sin(ahead), -rate
  design[:2, :, 6] = ox, oy
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
  return design.reshape(-1, 7), seen.ravel()


def solved(design: Array, seen: Array, which: int, held: tuple[float, float]) -> tuple[float, float]:
  """One of b and tau, the other nearly what is held of it, and its standard deviation, no less than residuals say."""
  expected, spread = np.zeros(7), np.array(FREE)
  expected[[BIAS, DELAY]] = held
  other = DELAY if which == BIAS else BIAS
  spread[other] = HELD[other]
  trust = np.diag(1.0 / spread**2)
  covariance = np.linalg.inv(design.T @ design + trust)
  found = expected + covariance @ (design.T @ (seen - design @ expected))
  residuals = seen - design @ found
  free = max(len(seen) - 6, 1)
  excess = max(1.0, float(residuals @ residuals) / free)
  return float(found[which]), math.sqrt(excess * covariance[which, which])
