"""Control laws under the names that scripts import: PID, Stanley, and both together."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_MOST_DUTY, _MOST_STEERING = 0.3, math.pi / 6  # of the car's own drive controller; duty, rad
_SLOWEST = 0.05  # m/s, below which the Stanley law would turn the wheels to their stops


class PID:
  """u = Kp e + Ki integral(e) - Kd dy/dt with e = r - y, clipped; the integral stops where u is clipped.

  Source: Astrom, Murray, Feedback Systems, Princeton University Press, 2008, ch. 10 (anti-windup; derivative of y).
  """

  def __init__(self, Kp: float = 0, Ki: float = 0, Kd: float = 0, uLimits: Sequence[float] | None = None):
    self.Kp, self.Ki, self.Kd = Kp, Ki, Kd
    self.uLimits = (-math.inf, math.inf) if uLimits is None else tuple(uLimits)
    self.reset()

  def reset(self) -> None:
    """Forget the past."""
    self.ei, self._before = 0.0, None

  def update(self, r: float, y: float, dt: float) -> float:
    """Control after a time step, s, from reference and measurement."""
    error, low, high = float(r) - float(y), *self.uLimits
    rate = 0.0 if self._before is None or dt <= 0.0 else (float(y) - self._before) / dt
    self._before: float | None = float(y)
    wanted = self.Kp * error + self.Ki * (self.ei + dt * error) - self.Kd * rate
    if low <= wanted <= high:
      self.ei += dt * error
    return min(max(wanted, low), high)


class StanleyController:
  """delta = psi + atan(k e / v): heading error psi [rad] and distance e to the path's left [m] at a speed v [m/s].

  Source: Hoffmann, Tomlin, Montemerlo, Thrun, Autonomous Automobile Trajectory Tracking for Off-Road Driving, ACC 2007.

  Args:
    waypoints: x and y, (2, N), m.
    k: gain, 1/s.
    cyclic: whether the path begins again at its end.

  Attributes:
    maxSteeringAngle: rad.  pathComplete: whether the last waypoint was passed.
    p_ref, th_ref: nearest point, (2,), m, and direction, rad, of the path.
  """

  def __init__(self, waypoints: Any, k: float = 1, cyclic: bool = True):
    self.k, self.maxSteeringAngle = k, _MOST_STEERING
    self.updatePath(waypoints, cyclic)

  def updatePath(self, waypoints: Any, cyclic: bool) -> None:
    """Follow another path from its beginning."""
    self.wp, self.cyclic = np.asarray(waypoints, dtype=float), cyclic
    if self.wp.ndim != 2 or self.wp.shape[0] != 2 or self.wp.shape[1] < 2:
      raise ValueError(f"StanleyController: waypoints must be (2, N) with N of 2 or more, not {self.wp.shape}")
    self.N, self.wpi, self.pathComplete = self.wp.shape[1], 0, False
    self.p_ref, self.th_ref = self.wp[:, 0].copy(), 0.0

  def update(self, p: Any, th: float, speed: float) -> float:
    """Steering angle, rad, from position (2,), m, heading, rad, and speed, m/s."""
    place = np.asarray(p, dtype=float).reshape(2)
    along, direction = self._advance(place)
    self.p_ref, self.th_ref = self.wp[:, self.wpi] + along * direction, math.atan2(direction[1], direction[0])
    gap = self.p_ref - place
    left = float(direction[0] * gap[1] - direction[1] * gap[0])  # of the car, where the path is
    turn = math.remainder(self.th_ref - float(th), math.tau)
    angle = math.remainder(turn + math.atan2(self.k * left, max(float(speed), _SLOWEST)), math.tau)
    return min(max(angle, -self.maxSteeringAngle), self.maxSteeringAngle)

  def _advance(self, place: Array) -> tuple[float, Array]:
    """Go on to the piece of the path that the car is at: how far along it, m, and its direction."""
    for _ in range(self.N):
      first, second = self.wp[:, self.wpi], self.wp[:, (self.wpi + 1) % self.N]
      length = float(np.linalg.norm(second - first))
      direction = (second - first) / length if length > 0.0 else np.array([1.0, 0.0])
      along = float((place - first) @ direction)
      if along < length:
        return max(along, 0.0) if self.wpi == 0 and not self.cyclic else along, direction
      if not self.cyclic and self.wpi >= self.N - 2:
        self.pathComplete = True
        return length, direction
      self.wpi = (self.wpi + 1) % self.N
    return along, direction


class QCarDriveController:
  """Speed by a PI law on the duty and steering by the Stanley law; at the end of the path the car is stopped.

  Args:
    waypoints, cyclic: of the path, see `StanleyController`.
  """

  def __init__(self, waypoints: Any, cyclic: bool):
    self.speedController = PID(0.1, 1, 0, (-_MOST_DUTY, _MOST_DUTY))
    self.steeringController = StanleyController(waypoints, 1, cyclic)

  def reset(self) -> None:
    """Forget the past, and follow the path from its beginning."""
    self.speedController.reset()
    self.steeringController.updatePath(self.steeringController.wp, self.steeringController.cyclic)

  def updatePath(self, waypoints: Any, cyclic: bool) -> None:
    """Follow another path from its beginning."""
    self.steeringController.updatePath(waypoints, cyclic)

  def update(self, p: Any, th: float, v: float, v_ref: float, dt: float) -> tuple[float, float]:
    """Duty and steering angle, rad, from position (2,), m, heading, rad, speed and its reference, m/s, and step, s."""
    steering = 0.0 if self.steeringController.pathComplete else self.steeringController.update(p, th, v)
    over = self.steeringController.pathComplete
    return self.speedController.update(0.0 if over else v_ref, v, dt), 0.0 if over else steering
