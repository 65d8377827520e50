"""A scanning lidar in a room: rays cast by MuJoCo, a pose and a score by scan matching.

The room is a static MuJoCo model of its own (walls and furniture as boxes), so the same lidar serves
every simulator of the car. The map the matcher uses is the room as someone surveyed it: its errors are
what makes a lidar pose wrong by the same amount for a while.
"""

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from qcar_twin.sensors.base import POSE, Mask, Timing
from qcar_twin.sensors.scan_matching import ScanMatcher
from qcar_twin.sensors.streams import CarStreams

Array = NDArray[np.float64]
WALL_HEIGHT = 0.5  # m
WALL_THICKNESS = 0.05  # m
GEOM_GROUP = 4  # of walls in a compiled model


@dataclasses.dataclass(frozen=True)
class Box:
  """An upright box: centre x, y and half sizes, m; yaw, rad."""

  x: float
  y: float
  half_x: float
  half_y: float
  yaw: float = 0.0

  def corners(self) -> Array:
    """(4, 2), counter-clockwise, m."""
    local = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (self.half_x, self.half_y)
    cos, sin = np.cos(self.yaw), np.sin(self.yaw)
    return local @ np.array([[cos, sin], [-sin, cos]]) + (self.x, self.y)


@dataclasses.dataclass(frozen=True)
class Room:
  """Boxes a car can neither drive nor see through."""

  boxes: tuple[Box, ...]

  @classmethod
  def around(cls, x: Array, y: Array, margin: float = 1.2, seed: int = 0) -> "Room":
    """Four walls around a driven area and furniture along them, no two places the same.

    Args:
      x, y: of the driven path, m; furniture stays 0.5 m away from it.
      margin: between path and walls, m.
      seed: of the furniture.
    """
    west, east = float(np.min(x)) - margin, float(np.max(x)) + margin
    south, north = float(np.min(y)) - margin, float(np.max(y)) + margin
    wide, high, t = 0.5 * (east - west), 0.5 * (north - south), 0.5 * WALL_THICKNESS
    mx, my = 0.5 * (east + west), 0.5 * (north + south)
    walls = [
      Box(mx, south - t, wide, t),
      Box(mx, north + t, wide, t),
      Box(west - t, my, t, high),
      Box(east + t, my, t, high),
    ]
    rng = np.random.default_rng(seed)
    furniture: list[Box] = []
    for _ in range(200):
      box = Box(
        float(rng.uniform(west, east)),
        float(rng.uniform(south, north)),
        half_x=float(rng.uniform(0.1, 0.3)),
        half_y=float(rng.uniform(0.1, 0.3)),
        yaw=float(rng.uniform(0.0, np.pi)),
      )
      if len(furniture) < 8 and np.min(np.hypot(box.x - x, box.y - y)) > 0.5 + np.hypot(box.half_x, box.half_y):
        furniture.append(box)
    return cls(tuple(walls + furniture))

  def surveyed(self, std: float, rng: np.random.Generator) -> "Room":
    """The room as measured: every box off by `std` m in place and std/2 per metre of its size in yaw."""

    def moved(box: Box) -> Box:
      dx, dy, turn = rng.standard_normal(3) * (std, std, std / (2.0 * max(box.half_x, box.half_y)))
      return dataclasses.replace(box, x=box.x + dx, y=box.y + dy, yaw=box.yaw + turn)

    return Room(tuple(moved(box) for box in self.boxes))

  def segments(self) -> Array:
    """All sides of all boxes as x1, y1, x2, y2, m, (4 K, 4)."""
    corners = np.stack([box.corners() for box in self.boxes])  # (K, 4, 2)
    return np.concatenate([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 4)

  def add_to(self, spec: mujoco.MjSpec) -> None:
    """Put the walls into a MuJoCo model, named wall_0, wall_1, ..."""
    for i, box in enumerate(self.boxes):
      spec.worldbody.add_geom(
        name=f"wall_{i}",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[box.x, box.y, 0.5 * WALL_HEIGHT],
        size=[box.half_x, box.half_y, 0.5 * WALL_HEIGHT],
        quat=[np.cos(0.5 * box.yaw), 0.0, 0.0, np.sin(0.5 * box.yaw)],
        group=GEOM_GROUP,
      )


class RayCaster:
  """Horizontal rays in a room.

  Args:
    room: what they hit.
    beams: rays per turn; beam i points at 2 pi i / beams from the car's x axis, counter-clockwise.
    reach: range beyond which nothing comes back, m.
    height: of the scan plane, m.
  """

  def __init__(self, room: Room, beams: int = 384, reach: float = 12.0, height: float = 0.12):
    spec = mujoco.MjSpec()
    room.add_to(spec)
    self._model = spec.compile()
    self._data = mujoco.MjData(self._model)
    mujoco.mj_forward(self._model, self._data)
    self.angles = 2.0 * np.pi * np.arange(beams) / beams
    self._reach, self._height = reach, height
    self._hit = np.empty(beams, dtype=np.int32)
    self._range = np.empty(beams)

  def cast(self, x: float, y: float, yaw: float) -> Array:
    """Ranges from a pose, m, (beams,); NaN where nothing is in reach."""
    angles = yaw + self.angles
    rays = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1)
    origin = np.array([x, y, self._height])
    count = len(angles)
    mujoco.mj_multiRay(
      self._model, self._data, origin, rays.ravel(), None, True, -1, self._hit, self._range, None, count, self._reach
    )
    return np.where((self._hit >= 0) & (self._range <= self._reach), self._range, np.nan)


@dataclasses.dataclass(frozen=True)
class ScanningLidar:
  """Lidar pose by scan matching.

  Attributes:
    room: what is there.
    map_std: error of the surveyed map, m.
    range_std, range_std_per_metre: white range noise, m, and its growth with range.
    missing: probability of losing a beam.
    beams, reach: see RayCaster.
    survey_seed: of the map's errors, one map for all runs.
  """

  room: Room
  timing: Timing = Timing(rate=10.0, latency=0.05, dropout=0.01)
  map_std: float = 0.01
  range_std: float = 0.01
  range_std_per_metre: float = 0.003
  missing: float = 0.02
  beams: int = 384
  reach: float = 12.0
  survey_seed: int = 0
  channels = ("pose_x", "pose_y", "pose_yaw", "pose_score")

  def begin(self, count: int, period: float, rng: np.random.Generator | CarStreams) -> "ScanningLidarRun":
    """Put it to work in N cars."""
    return ScanningLidarRun(self, count, rng)


class ScanningLidarRun:
  """Scans and matches of N cars; each starts its matcher at the true pose of its first scan, as a driver would."""

  def __init__(self, lidar: ScanningLidar, count: int, rng: np.random.Generator | CarStreams):
    self._lidar, self._rng = lidar, rng
    self._caster = RayCaster(lidar.room, lidar.beams, lidar.reach)
    surveyed = lidar.room.surveyed(lidar.map_std, np.random.default_rng(lidar.survey_seed))
    self._matcher = ScanMatcher(surveyed.segments(), self._caster.angles)
    self._last = np.full((count, 3), np.nan)
    self._before = np.full((count, 3), np.nan)

  def observe(self, signals: Array) -> None:
    """Nothing to remember between samples."""

  def scan(self, poses: Array) -> Array:
    """Noisy ranges from poses (N, 3), m, (N, beams)."""
    lidar = self._lidar
    ranges = np.stack([self._caster.cast(*pose) for pose in poses], axis=-1)
    ranges = ranges + self._rng.standard_normal(ranges.shape) * (lidar.range_std + lidar.range_std_per_metre * ranges)
    return np.where(self._rng.random(ranges.shape) < lidar.missing, np.nan, ranges).T

  def sample(self, signals: Array) -> Array:
    """pose_x, pose_y, pose_yaw, pose_score, (N, 4)."""
    out = np.empty((len(signals), 4))
    scans = self.scan(signals[:, POSE])
    for i, pose in enumerate(signals[:, POSE]):
      known = np.isfinite(self._last[i, 0])
      moving = np.isfinite(self._before[i, 0])
      guess = self._last[i] + (self._last[i] - self._before[i] if moving else 0.0) if known else pose
      match = self._matcher.match(scans[i], guess)
      out[i] = *match.pose, match.score
      self._before[i], self._last[i] = self._last[i], match.pose
    return out

  def restart(self, which: Mask, signals: Array) -> None:
    """The matcher of some cars starts at their true pose again."""
    self._last[which] = np.nan
    self._before[which] = np.nan
