"""`QCarEKF`: position and heading of a car from its speed, its steering angle, its gyro and the poses that come in."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.vehicle.similarity import WHEELBASE

_PROCESS = (1e-3, 1e-3, 1e-3)  # variances per s: m^2, m^2, rad^2; assumed, a few centimetres in a second
_POSE = (1e-4, 1e-4, 1e-4)  # variances of a pose: a centimetre, half a degree; assumed
_GYRO = 1e-4  # (rad/s)^2, variance of the gyro, assumed; of the rate that the steering implies ten times as much


class QCarEKF:
  """Extended Kalman filter on the kinematic single track (Rajamani 2012, 2.2): x' = v cos(yaw), y' = v sin(yaw),
  yaw' = v tan(delta) / L, or the gyro's rate where it is given.

  Args:
    x_0: x, y [m], yaw [rad].
    Q, R: covariances of a second of driving and of a pose, (3, 3).
    L: wheelbase, m.

  Attributes:
    x_hat: x, y [m], yaw [rad], (3, 1).  P: covariance, (3, 3).
  """

  def __init__(self, x_0: Sequence[float] = (0, 0, 0), Q: Any = None, R: Any = None, L: float = WHEELBASE):
    self.L = L
    self.x_hat: NDArray[np.float64] = np.array(x_0, dtype=float).reshape(3, 1)
    self.P = np.diag(_POSE)
    self.Q = np.diag(_PROCESS) if Q is None else np.asarray(Q, dtype=float)
    self.R = np.diag(_POSE) if R is None else np.asarray(R, dtype=float)

  def update(
    self, u: Sequence[float] | None = None, dt: float | None = None, y_gps: Any = None, y_imu: float | None = None
  ) -> None:
    """Move on by speed [m/s] and steering angle [rad] for `dt` s, then take in a pose (3,), if one came.

    Args:
      y_imu: yaw rate by the gyro, rad/s.
    """
    if u is not None and dt is not None:
      self._predict(float(u[0]), float(u[1]), float(dt), y_imu)
    if y_gps is not None:
      self._correct(np.asarray(y_gps, dtype=float).reshape(3, 1))

  def _predict(self, speed: float, steering: float, dt: float, gyro: float | None) -> None:
    yaw = self.x_hat[2, 0]
    rate = speed * math.tan(steering) / self.L if gyro is None else float(gyro)
    self.x_hat = self.x_hat + dt * np.array([[speed * math.cos(yaw)], [speed * math.sin(yaw)], [rate]])
    self.x_hat[2, 0] = math.remainder(self.x_hat[2, 0], math.tau)
    turned = np.eye(3)
    turned[:2, 2] = -dt * speed * math.sin(yaw), dt * speed * math.cos(yaw)
    self.P = turned @ self.P @ turned.T + dt * self.Q
    self.P[2, 2] += dt**2 * (_GYRO if gyro is not None else 10.0 * _GYRO)

  def _correct(self, pose: NDArray[np.float64]) -> None:
    residual = pose - self.x_hat
    residual[2, 0] = math.remainder(residual[2, 0], math.tau)
    gain = self.P @ np.linalg.inv(self.P + self.R)
    self.x_hat = self.x_hat + gain @ residual
    self.x_hat[2, 0] = math.remainder(self.x_hat[2, 0], math.tau)
    self.P = (np.eye(3) - gain) @ self.P
