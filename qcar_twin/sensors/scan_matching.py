"""Pose of a planar lidar in a known map of line segments: point-to-line ICP with a correlative search.

Sources: Censi, An ICP variant using a point-to-line metric, ICRA 2008; Olson, Real-time correlative scan
matching, ICRA 2009. Lengths in m, angles in rad; a pose is x, y, yaw.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from qcar_twin.kinematics import wrap_angle

Array = NDArray[np.float64]
KERNEL = 0.03  # m: residual at which a beam's weight has halved (Cauchy)
INLIER = 0.06  # m: residual up to which a beam counts as explained
GATES = (0.5, 0.3, 0.2, 0.15)  # m: farthest correspondence in the first iterations; the last one stays
LOW_SCORE = 50.0  # below it the pose is searched for


@dataclasses.dataclass(frozen=True)
class Match:
  """Result of matching one scan.

  Attributes:
    pose: x, y, yaw (unwrapped towards the guess), (3,).
    score: 0 to 100: share of the beams the map explains, less for large residuals.
    rms: of the explained beams' residuals, m.
    iterations: of Gauss-Newton, in all attempts.
  """

  pose: Array
  score: float
  rms: float
  iterations: int


class ScanMatcher:
  """Matches scans against a map.

  Args:
    segments: x1, y1, x2, y2, (S, 4).
    angles: of the beams from the car's x axis, (B,).
  """

  def __init__(self, segments: Array, angles: Array):
    start, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    self._length = np.hypot(*along.T)
    if np.any(self._length <= 0.0):
      raise ValueError(f"segment {int(np.argmin(self._length))} of the map has no length")
    self._start = start
    self._tangent = along / self._length[:, None]
    self._normal = np.stack([-self._tangent[:, 1], self._tangent[:, 0]], axis=-1)
    self._directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)

  def match(self, ranges: Array, guess: Array, iterations: int = 25) -> Match:
    """Pose of a scan (B,), NaN for beams without echo, near a guessed pose (3,).

    When ICP from the guess explains too little, the surroundings are searched and ICP starts again from
    the best place there.
    """
    points = (ranges[:, None] * self._directions)[np.isfinite(ranges)]
    if len(points) < 10:
      return Match(np.asarray(guess, dtype=np.float64), 0.0, np.inf, 0)
    best = self._icp(points, guess, iterations)
    if best.score < LOW_SCORE:
      again = self._icp(points, self._search(points, guess), iterations)
      best = max(best, again, key=lambda match: match.score)
    return best

  def _icp(self, points: Array, guess: Array, iterations: int) -> Match:
    pose, count = np.array(guess, dtype=np.float64), 0
    for count in range(1, iterations + 1):
      gate = GATES[min(count, len(GATES)) - 1]
      residual, normal, world = self._residuals(points, pose, gate)
      if len(residual) < 10:
        break
      arm = world - pose[:2]
      turn = normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]  # d residual / d yaw
      design = np.column_stack([normal, turn])
      weight = 1.0 / (1.0 + (residual / KERNEL) ** 2)
      information = design.T @ (design * weight[:, None]) + 1e-9 * np.eye(3)
      step = np.linalg.solve(information, -design.T @ (weight * residual))
      pose += step
      if np.hypot(step[0], step[1]) < 1e-6 and abs(step[2]) < 1e-6 and count >= len(GATES):
        break
    return self._judge(points, pose, guess, count)

  def _residuals(self, points: Array, pose: Array, gate: float) -> tuple[Array, Array, Array]:
    """Signed distance to the nearest segment's line, that line's normal and the point, for points within the gate."""
    world = _placed(points, pose)
    distance, nearest = self._nearest(world)
    keep = distance < gate
    world, nearest = world[keep], nearest[keep]
    normal = self._normal[nearest]
    return np.einsum("pi,pi->p", world - self._start[nearest], normal), normal, world

  def _nearest(self, world: Array) -> tuple[Array, NDArray[np.intp]]:
    """Distance to and index of the nearest segment, for points (P, 2)."""
    x = world[:, 0, None] - self._start[None, :, 0]  # (P, S)
    y = world[:, 1, None] - self._start[None, :, 1]
    along = x * self._tangent[:, 0] + y * self._tangent[:, 1]
    across = y * self._tangent[:, 0] - x * self._tangent[:, 1]
    beyond = along - np.clip(along, 0.0, self._length)
    squared = across * across + beyond * beyond
    nearest = np.argmin(squared, axis=1)
    return np.sqrt(squared[np.arange(len(world)), nearest]), nearest

  def _judge(self, points: Array, pose: Array, guess: Array, count: int) -> Match:
    distance, _ = self._nearest(_placed(points, pose))
    explained = distance < INLIER
    share = float(np.mean(explained))
    rms = float(np.sqrt(np.mean(distance[explained] ** 2))) if explained.any() else np.inf
    pose = np.array([pose[0], pose[1], guess[2] + float(wrap_angle(pose[2] - guess[2]))])
    score = 100.0 * share / (1.0 + (rms / KERNEL) ** 2) if share > 0.0 else 0.0
    return Match(pose, score, rms, count)

  def _search(self, points: Array, guess: Array, reach: float = 0.6, turn: float = 0.4) -> Array:
    """The pose on a grid around the guess at which most beams (every eighth is tried) lie on the map."""
    points = points[:: max(len(points) // 48, 1)]
    offsets = np.linspace(-reach, reach, 9)
    best, pose = -1.0, np.asarray(guess, dtype=np.float64)
    for yaw in guess[2] + np.linspace(-turn, turn, 9):
      rotated = _placed(points, np.array([0.0, 0.0, yaw]))
      for dx in offsets:
        for dy in offsets:
          place = np.array([guess[0] + dx, guess[1] + dy, yaw])
          distance, _ = self._nearest(rotated + place[:2])
          likelihood = float(np.mean(np.exp(-0.5 * (distance / 0.1) ** 2)))
          if likelihood > best:
            best, pose = likelihood, place
    return pose


def _placed(points: Array, pose: Array) -> Array:
  """Points (P, 2) of the car's frame in the world."""
  cos, sin = np.cos(pose[2]), np.sin(pose[2])
  return points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
