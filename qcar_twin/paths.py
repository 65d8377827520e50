"""Reference paths of continuous curvature: S (training), O, infinity and C (validation).

A path is a chain of pieces whose curvature is linear in arc length: straights, clothoids, arcs.
Yaw is then known in closed form and position by quadrature. Curvature [1/m] and yaw [rad] are
positive counter-clockwise (ISO 8855), the cross-track error is positive to the left of the path.
"""

import dataclasses
import difflib
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from qcar_twin.kinematics import wrap_angle

Array = NDArray[np.float64]
Piece = tuple[float, float, float]  # length [m], curvature at its start and at its end [1/m]
Pose = tuple[float, float, float]  # x [m], y [m], yaw [rad]
SPACING = 0.005  # m, between stored points
CAR_WIDTH = 0.19  # m, what the lanes of the double lane change are made for
CAR_LENGTH = 0.39  # m
LIMIT = 0.2  # share of 1/curvature beyond which the along-path rate is held: 1 - kappa dy stays positive


@dataclasses.dataclass(frozen=True)
class Lane:
  """One marked section of a double lane change, in world axes: x from start to end, y from right to left, m."""

  start: float
  end: float
  right: float
  left: float


@dataclasses.dataclass(frozen=True)
class Reference:
  """The path at some arc lengths: position m, yaw rad (unwrapped), curvature 1/m; equal shapes."""

  x: Array
  y: Array
  yaw: Array
  curvature: Array


@dataclasses.dataclass(frozen=True)
class Errors:
  """A car relative to the path, the paper's eq. (state_observation); equal shapes.

  Attributes:
    cross_track: m, (Y - Y_ref) cos psi_ref - (X - X_ref) sin psi_ref.
    cross_track_rate: m/s, v_x sin dpsi + v_y cos dpsi, its exact derivative.
    heading: rad, psi - psi_ref in (-pi, pi].
    heading_rate: rad/s, r - kappa ds/dt.
    arc_rate: m/s, ds/dt.
    curvature: 1/m, of the path there.
  """

  cross_track: Array
  cross_track_rate: Array
  heading: Array
  heading_rate: Array
  arc_rate: Array
  curvature: Array

  @property
  def observation(self) -> Array:
    """(..., 4): cross-track error, its rate, heading error, its rate: what the paper's agent sees."""
    return np.stack([self.cross_track, self.cross_track_rate, self.heading, self.heading_rate], axis=-1)


@dataclasses.dataclass(frozen=True)
class Path:
  """A reference path stored at equal spacing.

  Attributes:
    name: one of PATHS, or the maker's choice.
    x, y, yaw, curvature: m, m, rad (unwrapped), 1/m at `arc_length`, (M,).
    arc_length: m, (M,), from 0 to the length.
    closed: whether the end meets the start.
    lanes: marked sections a car must stay in; empty for none.
  """

  name: str
  arc_length: Array
  x: Array
  y: Array
  yaw: Array
  curvature: Array
  closed: bool
  lanes: tuple[Lane, ...] = ()

  @property
  def length(self) -> float:
    """Of the whole path (one lap of a closed one), m."""
    return float(self.arc_length[-1])

  @property
  def start(self) -> Pose:
    """Pose at arc length zero."""
    return float(self.x[0]), float(self.y[0]), float(self.yaw[0])

  def at(self, arc_length: ArrayLike) -> Reference:
    """Position, yaw and curvature at arc lengths of any shape.

    A closed path repeats, its yaw keeps turning; an open one is continued straight at both ends.
    """
    s = np.asarray(arc_length, dtype=np.float64)
    laps = np.floor(s / self.length) if self.closed else np.zeros_like(s)
    s = s - laps * self.length
    spacing = self.arc_length[1]
    i = np.clip((s / spacing).astype(np.int64), 0, len(self.x) - 2)
    t = s - i * spacing
    inside = np.clip(t, 0.0, spacing)
    slope = (self.curvature[i + 1] - self.curvature[i]) / spacing
    curvature = self.curvature[i] + slope * inside
    turned = inside * (self.curvature[i] + 0.5 * slope * inside)
    middle = self.yaw[i] + 0.5 * inside * (self.curvature[i] + 0.25 * slope * inside)
    yaw = self.yaw[i] + turned
    x = self.x[i] + inside * np.cos(middle) + (t - inside) * np.cos(yaw)
    y = self.y[i] + inside * np.sin(middle) + (t - inside) * np.sin(yaw)
    yaw = yaw + laps * (self.yaw[-1] - self.yaw[0])
    outside = (s < 0.0) | (s > self.length)
    return Reference(x, y, yaw, np.where(outside, 0.0, curvature))

  def nearest(self, x: ArrayLike, y: ArrayLike, near: ArrayLike | None = None, window: float = 0.3) -> Array:
    """Arc length of the nearest path point.

    Args:
      x, y: positions, m, any common shape.
      near: arc lengths to search around, m; None searches the whole path (ambiguous at a crossing).
      window: half-width of that search, m.
    """
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if near is not None:
      near = np.broadcast_to(np.asarray(near, dtype=np.float64), x.shape)
      s = self._foot(x, y, near)
      if np.all(np.abs(s - near) < 0.5 * window):
        return s  # a foot point right where it was expected
      grid = near[..., None] + np.linspace(-window, window, 25)
    else:
      grid = np.broadcast_to(self.arc_length, (*x.shape, len(self.arc_length)))
    points = self.at(grid)
    best = np.argmin((points.x - x[..., None]) ** 2 + (points.y - y[..., None]) ** 2, axis=-1)
    return self._foot(x, y, np.take_along_axis(grid, best[..., None], axis=-1)[..., 0])

  def _foot(self, x: Array, y: Array, s: Array) -> Array:
    """Newton on (p - p_ref) . tangent = 0 from arc lengths s."""
    for _ in range(3):
      point = self.at(s)
      dx, dy = x - point.x, y - point.y
      cos, sin = np.cos(point.yaw), np.sin(point.yaw)
      s = s + (dx * cos + dy * sin) / _clearance(point.curvature, dy * cos - dx * sin)
    return s

  def errors(self, arc_length: ArrayLike, pose: Array, velocity: Array, yaw_rate: ArrayLike) -> Errors:
    """Errors of cars at the path's arc length.

    Args:
      arc_length: m, (...).
      pose: x, y, yaw of the centre of gravity, m, m, rad, (..., 3).
      velocity: body frame v_x, v_y, m/s, (..., 2).
      yaw_rate: rad/s, (...).
    """
    point = self.at(arc_length)
    x, y, yaw = np.moveaxis(pose, -1, 0)
    forward, left = np.moveaxis(velocity, -1, 0)
    dx, dy = x - point.x, y - point.y
    across = dy * np.cos(point.yaw) - dx * np.sin(point.yaw)
    heading = wrap_angle(yaw - point.yaw)
    cos, sin = np.cos(heading), np.sin(heading)
    rate = (forward * cos - left * sin) / _clearance(point.curvature, across)
    lateral = forward * sin + left * cos
    turn = np.asarray(yaw_rate) - point.curvature * rate
    return Errors(across, lateral, heading, turn, rate, point.curvature)

  def inside_lanes(self, x: Array, y: Array, yaw: Array, width: float = CAR_WIDTH, length: float = CAR_LENGTH) -> Array:
    """Whether the car's four corners stay inside every lane they are alongside, at each pose; (...) of bool."""
    ok = np.ones(np.shape(x), dtype=bool)
    for forward, left in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
      a, b = 0.5 * forward * length, 0.5 * left * width
      cx = x + a * np.cos(yaw) - b * np.sin(yaw)
      cy = y + a * np.sin(yaw) + b * np.cos(yaw)
      for lane in self.lanes:
        alongside = (cx >= lane.start) & (cx <= lane.end) & (np.abs(cy - 0.5 * (lane.left + lane.right)) < 0.5)
        ok &= ~alongside | ((cy >= lane.right) & (cy <= lane.left))
    return ok


def _clearance(curvature: Array, across: Array) -> Array:
  """1 - kappa dy, the denominator of ds/dt, held away from zero far inside a curve."""
  return np.maximum(1.0 - curvature * across, LIMIT)


def path_from_pieces(
  name: str, pieces: Sequence[Piece], start: Pose = (0.0, 0.0, 0.0), closed: bool = False, lanes: Sequence[Lane] = ()
) -> Path:
  """Integrate a chain of linear-curvature pieces from a start pose; jumps of curvature are an error."""
  for (_, _, before), (_, after, _) in zip(pieces[:-1], pieces[1:], strict=True):
    if abs(before - after) > 1e-9:
      raise ValueError(f"path '{name}': curvature jumps from {before:g} to {after:g} 1/m; put a clothoid between")
  lengths = np.array([p[0] for p in pieces])
  if np.any(lengths < 0.0):
    raise ValueError(f"path '{name}': a piece has negative length; the turn is too short for its transitions")
  edges = np.concatenate([[0.0], np.cumsum(lengths)])
  grid = np.linspace(0.0, edges[-1], int(np.ceil(edges[-1] / SPACING)) + 1)
  nodes, weights = np.polynomial.legendre.leggauss(4)
  step = grid[1]
  inner = grid[:-1, None] + 0.5 * step * (nodes + 1.0)  # (M - 1, 4)
  yaw_inner = start[2] + _yaw(pieces, edges, inner)[0]
  dx, dy = (0.5 * step * (f(yaw_inner) @ weights) for f in (np.cos, np.sin))
  x = start[0] + np.concatenate([[0.0], np.cumsum(dx)])
  y = start[1] + np.concatenate([[0.0], np.cumsum(dy)])
  turned, curvature = _yaw(pieces, edges, grid)
  arrays = [grid, x, y, start[2] + turned, curvature]
  for array in arrays:
    array.flags.writeable = False
  return Path(name, *arrays, closed=closed, lanes=tuple(lanes))


def _yaw(pieces: Sequence[Piece], edges: Array, s: Array) -> tuple[Array, Array]:
  """Yaw turned since the start and curvature at arc lengths, in closed form."""
  length, first, last = (np.array(column) for column in zip(*pieces, strict=True))
  turned = np.concatenate([[0.0], np.cumsum(0.5 * length * (first + last))])
  i = np.clip(np.searchsorted(edges, s, side="right") - 1, 0, len(pieces) - 1)
  t = s - edges[i]
  slope = np.divide(last - first, length, out=np.zeros_like(length), where=length > 0.0)[i]
  return turned[i] + t * (first[i] + 0.5 * slope * t), first[i] + slope * t


def _root(function: Callable[[float], float], low: float, high: float, xtol: float) -> float:
  """Where a function changes its sign."""
  return float(np.asarray(brentq(function, low, high, xtol=xtol)))


def turn(angle: float, curvature: float, ramp: float) -> list[Piece]:
  """A turn by `angle` rad at `curvature` 1/m (same sign) with a clothoid of length `ramp` m at each end."""
  return [(ramp, 0.0, curvature), (angle / curvature - ramp, curvature, curvature), (ramp, curvature, 0.0)]


def s_shape() -> Path:
  """The training path: half a turn left at 0.80 m radius, half a turn right at 0.60 m, straights at the ends."""
  pieces = [(0.5, 0.0, 0.0), *turn(np.pi, 1.0 / 0.80, 0.35), *turn(-np.pi, -1.0 / 0.60, 0.35), (0.8, 0.0, 0.0)]
  return path_from_pieces("s", pieces)


def o_shape() -> Path:
  """An oval, 1.2 m straights and 0.75 m radius, driven counter-clockwise from the middle of a straight."""
  half = [(0.6, 0.0, 0.0), *turn(np.pi, 1.0 / 0.75, 0.35), (0.6, 0.0, 0.0)]
  return path_from_pieces("o", half + half, closed=True)


def infinity_shape() -> Path:
  """A figure of eight: two lobes of 0.70 m radius crossing at the origin, tighter nowhere than the S.

  The half straight between crossing and lobe follows from the lobe's closing on the crossing.
  """
  curvature, ramp, crossing = 1.0 / 0.70, 0.35, np.radians(40.0)

  def lobe(half_straight: float) -> list[Piece]:
    line = (half_straight, 0.0, 0.0)
    return [line, *turn(np.pi + 2.0 * crossing, curvature, ramp), line]

  def miss(half_straight: float) -> float:
    path = path_from_pieces("lobe", lobe(half_straight), start=(0.0, 0.0, -crossing))
    return path.y[-1]

  left = lobe(_root(miss, 0.05, 3.0, xtol=1e-13))
  right = [(length, -first, -last) for length, first, last in left]
  return path_from_pieces("infinity", left + right, start=(0.0, 0.0, -crossing), closed=True)


def double_lane_change(origin: float, base: float, scale: float = 0.1) -> tuple[list[Piece], tuple[Lane, ...]]:
  """ISO 3888-2 scaled: parts 12, 13.5, 11, 12.5, 12 m; lanes b1 = 1.1 w + 1/4, b3 = w + 1, b5 = max(1.3 w + 1/4, 3) m.

  Lanes 1 and 5 share their right border, lane 3 begins 1 m to the left of lane 1's left border. The path
  runs in the lanes' middles; each change is two opposite trapezia of curvature.

  Args:
    origin, base: x of the entry and y of lane 1's middle, m.
    scale: model scale; w is the car's width over it.
  """
  wide = CAR_WIDTH / scale
  widths = np.array([1.1 * wide + 0.25, wide + 1.0, max(1.3 * wide + 0.25, 3.0)]) * scale
  lengths = np.array([12.0, 13.5, 11.0, 12.5, 12.0]) * scale
  edges = origin + np.concatenate([[0.0], np.cumsum(lengths)])
  rights = base - 0.5 * widths[0] + np.array([0.0, widths[0] + scale, 0.0])
  sides = zip(edges[[0, 2, 4]], edges[[1, 3, 5]], rights, rights + widths, strict=True)
  lanes = tuple(Lane(*map(float, side)) for side in sides)
  middles = rights + 0.5 * widths
  out = lane_change(float(lengths[1]), float(middles[1] - middles[0]))
  back = lane_change(float(lengths[3]), float(middles[2] - middles[1]))
  line = [(float(length), 0.0, 0.0) for length in lengths]
  return [line[0], *out, line[2], *back, line[4]], lanes


def lane_change(advance: float, offset: float) -> list[Piece]:
  """Curvature pieces that move a path sideways by `offset` m over `advance` m along the old direction.

  Each half has ramps of an eighth of its own path length; curvature and path length are solved for
  exactly (the small-angle answer is offset = 3/16 curvature advance^2).
  """
  sign = np.sign(offset)

  def pieces(curvature: float, length: float) -> list[Piece]:
    k, ramp, hold = sign * curvature, length / 8.0, length / 4.0
    half = [(ramp, 0.0, k), (hold, k, k), (ramp, k, 0.0)]
    return half + [(a, -b, -c) for a, b, c in half]

  def length_for(curvature: float) -> float:
    def reach(length: float) -> float:
      return path_from_pieces("change", pieces(curvature, length)).x[-1] - advance

    return _root(reach, advance, 1.5 * advance, xtol=1e-13)

  def miss(curvature: float) -> float:
    return path_from_pieces("change", pieces(curvature, length_for(curvature))).y[-1] - offset

  guess = 16.0 * abs(offset) / (3.0 * advance**2)
  curvature = _root(lambda k: sign * miss(k), 0.5 * guess, 1.6 * guess, xtol=1e-12)
  return pieces(curvature, length_for(curvature))


def c_shape() -> Path:
  """Half a turn of 0.80 m radius to the left, then the scaled double lane change along +x with its borders."""
  entry, exit_line = (0.4, 0.0, 0.0), (0.8, 0.0, 0.0)
  half_turn = [entry, *turn(np.pi, 1.0 / 0.80, 0.35), exit_line]
  probe = path_from_pieces("half turn", half_turn, start=(0.0, 0.0, np.pi))
  origin, base = float(probe.x[-1]), float(probe.y[-1])
  change, lanes = double_lane_change(origin, base)
  return path_from_pieces("c", half_turn + change + [(0.6, 0.0, 0.0)], start=(0.0, 0.0, np.pi), lanes=lanes)


PATHS = {"s": s_shape, "o": o_shape, "infinity": infinity_shape, "c": c_shape}


def path_named(name: str) -> Path:
  """One of PATHS.

  Raises:
    KeyError: unknown name, with the nearest known one.
  """
  if name not in PATHS:
    near = difflib.get_close_matches(name, PATHS, n=1) or list(PATHS)
    raise KeyError(f"no path '{name}'; did you mean {', '.join(near)}?")
  return PATHS[name]()
