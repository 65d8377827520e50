"""The federated filter of one car on filterpy's `ExtendedKalmanFilter`, measurements in time: ours must equal it.

Joint updates with filterpy's own algebra (a matrix inverse, Joseph form), gates on the joint NIS, fusion by
information matrices; of the product only the motion models are shared.
"""

import math
from collections import Counter

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from qcar_twin.estimation import models


class Extended(ExtendedKalmanFilter):
  """filterpy's filter, told the next state by a nonlinear model and the innovation by its user."""

  def __init__(self, state, covariance, noise):
    super().__init__(dim_x=len(state), dim_z=1)
    self.x, self.P, self.Q = (np.array(a, dtype=float) for a in (state, covariance, noise))

  def predict_x(self, u=0):
    self.x = self.following

  def predict_to(self, following, transition):
    self.following, self.F = np.array(following), transition
    self.predict()

  def nis(self, slopes, innovation, noise):
    total = slopes @ self.P @ slopes.T + noise
    return innovation @ np.linalg.solve(total, innovation)

  def absorb(self, slopes, innovation, noise):
    """`innovation` (k,) of measurements with slopes H (k, n) and noise R (k, k)."""
    self.update(np.array(innovation), lambda _: slopes, lambda _: 0.0, noise)


def fuse(states, covariances):
  """(sum P_i^-1)^-1 and its product with sum P_i^-1 x_i, over estimates (..., n) and covariances (..., n, n)."""
  information = [np.linalg.inv(covariance) for covariance in covariances]
  fused = np.linalg.inv(np.sum(information, axis=0))
  weighted = np.sum([i @ x[..., None] for i, x in zip(information, states, strict=True)], axis=0)
  return (fused @ weighted)[..., 0], fused


class Reference:
  """EKF_BM, EKF_PM and master, without the verdicts on lost cars and encoders."""

  def __init__(self, car, settings, pose, speed, std=0.01):
    x, y, yaw = pose
    self.car, self.settings, self.angle, self.refused = car, settings, 0.0, Counter()
    spread = np.diag(np.square([std, std, 0.5, std, 0.1, 0.5]))
    self.bicycle = Extended([x, y, speed, yaw, 0.0, 0.0], spread, settings.bicycle_noise)
    velocity = speed * math.cos(yaw), speed * math.sin(yaw)
    self.point = Extended([x, y, *velocity], np.diag(np.square([std, std, 0.5, 0.5])), settings.point_noise)

  def step(self, commands, accel, motion, fix):
    """One period: inputs (2,) and (2,) that act over it, speed and yaw rate (2,), pose (3,) and score or None."""
    settings, h = self.settings, self.settings.period
    lag = settings.steering_lag
    self.angle += (1.0 - math.exp(-h / lag) if lag else 1.0) * (commands[1] - self.angle)
    before = self.bicycle.x.tolist()
    r = before[models.R]
    at_centre = models.cg_acceleration(
      (accel[0] - settings.accel_x_bias, accel[1] - settings.accel_y_bias), r, (settings.imu_x, settings.imu_y)
    )
    ahead = models.point_step(tuple(self.point.x), at_centre, before[models.YAW] + 0.5 * h * r, h)
    transition = np.eye(4)
    transition[0, 2] = transition[1, 3] = h
    self.point.predict_to(ahead, transition)
    following, entries = models.bicycle_step(before, commands[0], self.angle, self.car, h)
    transition = np.eye(6)
    models.fill_jacobian(transition, entries, h)
    self.bicycle.predict_to(following, transition)
    self._correct_motion(np.asarray(motion) - (0.0, settings.yaw_rate_bias))
    if fix is not None:
      self._correct_pose(np.asarray(fix[:3], dtype=float), fix[3])

  def _correct_motion(self, motion):
    settings = self.settings
    motion[0] /= 1.0 + settings.front_drive_share * (1.0 / math.cos(self.angle) - 1.0)
    rows, variances = (models.V, models.R), (settings.speed_std**2, settings.yaw_rate_std**2)
    kept = []
    for k in range(2):
      innovation = motion[k] - self.bicycle.x[rows[k]]
      if innovation**2 <= settings.limits[0] * (self.bicycle.P[rows[k], rows[k]] + variances[k]):
        kept.append(k)
      else:
        self.refused[("speed", "yaw_rate")[k], "gate"] += 1
    if kept:
      which = [rows[k] for k in kept]
      innovation = motion[kept] - self.bicycle.x[which]
      self.bicycle.absorb(np.eye(6)[which], innovation, np.diag([variances[k] for k in kept]))

  def _correct_pose(self, pose, score):
    settings = self.settings
    position, yaw = settings.pose_noise(float(score))
    there = np.flatnonzero(np.isfinite(pose))
    rows = np.array([models.X, models.Y, models.YAW])[there]
    innovation = pose[there] - self.bicycle.x[rows]
    if 2 in there:
      innovation[-1] = math.remainder(innovation[-1], math.tau)
    slopes, noise = np.eye(6)[rows], np.diag(np.array([position, position, yaw])[there]) / settings.sharing[0]
    if self.bicycle.nis(slopes, innovation, noise) > settings.limits[len(there) - 1]:
      self.refused["pose", "gate"] += 1
      return
    self.bicycle.absorb(slopes, innovation, noise)
    there = there[there < 2]
    if len(there):
      slopes, noise = np.eye(4)[there], position * np.eye(len(there)) / settings.sharing[1]
      self.point.absorb(slopes, pose[there] - self.point.x[there], noise)

  @property
  def position(self):
    """The master's, with its covariance."""
    local = (self.bicycle, self.point)
    return fuse([f.x[:2] for f in local], [f.P[:2, :2] for f in local])
