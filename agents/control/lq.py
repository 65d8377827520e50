"""Linear-quadratic path tracking on the error model of the identified single track.

Error state x = [dy, d(dy)/dt, dpsi, d(dpsi)/dt] about a path of curvature kappa at constant speed v
(Rajamani, Vehicle Dynamics and Control, 2nd ed. 2012, sec. 2.5, stiffnesses per axle):
  dy''   = -(C / (m v)) dy' + (C / m) dpsi - (c1 / (m v)) dpsi' + (C_f / m) delta - (c1 / (m v) + v) kappa v
  dpsi'' = -(c1 / (I v)) dy' + (c1 / I) dpsi - (c2 / (I v)) dpsi' + (C_f L_f / I) delta - (c2 / (I v)) kappa v
with C = C_f + C_r, c1 = C_f L_f - C_r L_r, c2 = C_f L_f^2 + C_r L_r^2.

LQ_ed: delta = -K x, no curvature compensation (Chatzikomis et al., Comparison of path tracking and
torque-vectoring controllers for autonomous electric vehicles, IEEE Trans. Intelligent Vehicles 3(4), 2018).
LQ_cm: the discrete LQ with the feed-forward that leaves no lateral error in a constant curve (Snider, Automatic
steering methods for autonomous automobile path tracking, CMU-RI-TR-09-08, 2009, sec. 3.3).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are

from agents.control.interface import Situation
from qcar_twin.bicycle.single_track import SingleTrackCar

Array = NDArray[np.float64]


def error_model(car: SingleTrackCar, speed: float) -> tuple[Array, Array, Array]:
  """A (4, 4), input column (4,) of steering and disturbance column (4,) of curvature, at a speed, m/s."""
  front, rear = float(np.asarray(car.cornering_stiffness_front)), float(np.asarray(car.cornering_stiffness_rear))
  mass, inertia = float(np.asarray(car.mass)), float(np.asarray(car.yaw_inertia))
  ahead, behind = float(np.asarray(car.cg_to_front)), float(np.asarray(car.cg_to_rear))
  c0, c1, c2 = front + rear, front * ahead - rear * behind, front * ahead**2 + rear * behind**2
  matrix = np.array(
    [
      [0.0, 1.0, 0.0, 0.0],
      [0.0, -c0 / (mass * speed), c0 / mass, -c1 / (mass * speed)],
      [0.0, 0.0, 0.0, 1.0],
      [0.0, -c1 / (inertia * speed), c1 / inertia, -c2 / (inertia * speed)],
    ]
  )
  steering = np.array([0.0, front / mass, 0.0, front * ahead / inertia])
  curvature = np.array([0.0, -(c1 / (mass * speed) + speed) * speed, 0.0, -c2 / inertia])
  return matrix, steering, curvature


def discrete_error_model(car: SingleTrackCar, speed: float, period: float) -> tuple[Array, Array]:
  """State matrix (4, 4) and steering column (4, 1) over one period of held steering; exact."""
  matrix, steering, _ = error_model(car, speed)
  block = np.zeros((5, 5))
  block[:4, :4], block[:4, 4] = matrix, steering
  step = np.asarray(expm(block * period), dtype=np.float64)
  return step[:4, :4], step[:4, 4:]


def lq_gain(car: SingleTrackCar, speed: float, weights: Sequence[float], effort: float, period: float = 0.01) -> Array:
  """K (4,) of delta = -K x minimising sum x' diag(weights) x + effort delta^2.

  Args:
    weights: of dy, dy', dpsi, dpsi', not negative, the first positive.
    effort: of steering, positive.
  """
  if effort <= 0.0 or min(weights) < 0.0 or weights[0] <= 0.0:
    raise ValueError(f"weights must be (positive, >= 0, >= 0, >= 0) and effort positive, got {weights}, {effort}")
  a, b = discrete_error_model(car, speed, period)
  r = np.array([[effort]])
  p = solve_discrete_are(a, b, np.diag(np.asarray(weights, dtype=np.float64)), r)
  return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)[0]


def steady_curve(car: SingleTrackCar, speed: float) -> tuple[float, float]:
  """Steering, rad, and heading error, rad, per curvature, 1/m, of steady driving on the path without lateral error."""
  matrix, steering, curvature = error_model(car, speed)
  rows = [1, 3]
  system = np.column_stack([steering[rows], matrix[rows, 2]])
  delta, heading = np.linalg.solve(system, -curvature[rows])
  return float(delta), float(heading)


@dataclasses.dataclass(frozen=True)
class LqEd:
  """delta = -K x. `gain` is (4,), or (N, 4) for N cars with gains of their own."""

  gain: Array
  name: str = "lq_ed"

  @classmethod
  def design(cls, car: SingleTrackCar, speed: float, weights: Sequence[float], effort: float) -> "LqEd":
    """Gain of the discrete LQ problem at a speed, m/s; see `lq_gain` for the weights."""
    return cls(lq_gain(car, speed, weights, effort))

  def steer(self, situation: Situation) -> Array:
    """Steering command, rad, (N,)."""
    return -np.sum(self.gain * situation.errors.observation, axis=-1)


@dataclasses.dataclass(frozen=True)
class LqCm:
  """delta = delta_ss - K (x - x_ss) with the steady cornering of the path's curvature.

  Attributes:
    gain: (4,) or (N, 4).
    steering, heading: steady steering and heading error per curvature, see `steady_curve`, rad m.
  """

  gain: Array
  steering: float
  heading: float
  name: str = "lq_cm"

  @classmethod
  def design(cls, car: SingleTrackCar, speed: float, weights: Sequence[float], effort: float) -> "LqCm":
    """Gain and steady curve at a speed, m/s; see `lq_gain` for the weights."""
    return cls(lq_gain(car, speed, weights, effort), *steady_curve(car, speed))

  def steer(self, situation: Situation) -> Array:
    """Steering command, rad, (N,)."""
    error = situation.errors.observation.copy()
    error[:, 2] -= self.heading * situation.errors.curvature
    return self.steering * situation.errors.curvature - np.sum(self.gain * error, axis=-1)
