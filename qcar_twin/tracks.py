"""A path by what a person calls it: one of `paths.PATHS`, a random track, or points of one's own in a CSV file."""

import difflib
import logging
import math
import re
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from qcar_twin.paths import PATHS, SPACING, Path, Piece, path_from_pieces, path_named, turn
from qcar_twin.recordings.unit_names import unit_of, words_of
from qcar_twin.untrusted import read_text
from qcar_twin.vehicle.vehicle import QCAR

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
TIGHTEST = 1.0 / 0.6  # 1/m, of random tracks: the training path's
RAMP = 0.35  # m, length of their clothoids: the training path's
LENGTH = 12.0  # m, of a random track of which no length is said
FARTHEST = 10.0  # m between neighbouring points of a path: a full-size car's four lengths, 40 of a QCar's
EDGE = 1e5  # m from the origin: a map's eastings and northings are beyond, no floor and no race track is


def path_from(name: str, laps: int = 1) -> Path:
  """A path that is driven for so many laps.

  Args:
    name: one of `paths.PATHS`; "random:SEED" or "random:SEED:LENGTH", see `random_track`; or a file name that ends in
      .csv, see `path_from_csv`.
    laps: more than one of a closed path only.

  Raises:
    KeyError: unknown name, with the nearest known one.
    ValueError, FileNotFoundError: a track or a file that cannot be, or laps of an open path, with the cure.
  """
  path = _path_from(name)
  if laps != 1 and not path.closed:
    raise ValueError(
      f"{laps} laps of path '{name}', which is open: leave laps out, or take a closed one, as o, infinity, or a CSV"
      " file whose last point is its first"
    )
  return path


def _path_from(name: str) -> Path:
  if name.lower().endswith(".csv"):
    return path_from_csv(name)
  kind, *numbers = name.split(":")
  if kind != "random":
    if name not in PATHS:
      near = difflib.get_close_matches(name.lower(), [*PATHS, "random:1"], n=1) or [*PATHS, "random:SEED", "FILE.csv"]
      raise KeyError(f"no path '{name}'; did you mean {', '.join(near)}?")
    return path_named(name)
  try:
    seed, length = int(numbers[0]), float(numbers[1]) if len(numbers) > 1 else LENGTH
  except (IndexError, ValueError):
    raise ValueError(f"path '{name}': a random track is random:SEED or random:SEED:LENGTH, as random:7:20") from None
  return random_track(seed, length)


def random_track(seed: int, length: float = LENGTH) -> Path:
  """Turns of random side, angle (up to half a turn) and curvature (up to the training path's) between straights.

  It may cross itself: a car's place on a path is searched near where it was.

  Args:
    length: m; the track is at most a turn longer.
  """
  if seed < 0 or not 2.0 <= length <= 5000.0:
    raise ValueError(f"random track: a seed from 0 on and 2 to 5000 m, not seed {seed} and {length:g} m")
  rng = np.random.default_rng([seed, 0])
  pieces: list[Piece] = [(0.5, 0.0, 0.0)]
  while sum(piece[0] for piece in pieces) < length - 0.5:
    curvature, side = rng.uniform(0.3, TIGHTEST), rng.choice([-1.0, 1.0])
    angle = rng.uniform(curvature * RAMP, math.pi)
    pieces += turn(side * angle, side * curvature, RAMP)
    pieces.append((float(rng.uniform(0.0, 1.0) * (rng.random() < 0.5)), 0.0, 0.0))
  return path_from_pieces(f"random:{seed}", [*pieces, (0.5, 0.0, 0.0)])


def path_from_csv(file: str | FilePath) -> Path:
  """The smooth curve through points: columns x and y, in m or in the unit of their names (`x [cm]`, `y_mm`).

  Of a file of two columns the names may be missing; of more, as a race line's, a line before the numbers names x and y.

  A cubic spline over the chords' lengths, at equal spacing of arc length; closed where the last point is the first.

  Raises:
    FileNotFoundError: no such file.
    ValueError: with file, row and cure.
  """
  if not FilePath(file).exists():
    raise FileNotFoundError(f"{file}: no such file; a path of one's own is a CSV file of two columns x, y in m")
  points = _points(FilePath(file))
  closed = bool(np.hypot(*(points[-1] - points[0])) < 1e-6)
  if closed:
    points[-1] = points[0]
  chords = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
  spline = CubicSpline(chords, points, bc_type="periodic" if closed else "natural")
  fine = np.linspace(0.0, chords[-1], max(4 * len(points), int(np.ceil(4.0 * chords[-1] / SPACING))) + 1)
  speed = np.hypot(*spline(fine, 1).T)
  arc = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(fine) * (speed[1:] + speed[:-1]))])
  grid = np.linspace(0.0, arc[-1], int(np.ceil(arc[-1] / SPACING)) + 1)
  at = np.interp(grid, arc, fine)
  (x, y), (dx, dy), (ddx, ddy) = spline(at).T, spline(at, 1).T, spline(at, 2).T
  curvature = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
  tight = int(np.argmax(np.abs(curvature)))
  least = QCAR.wheelbase / math.tan(QCAR.max_steering)
  if (radius := 1.0 / max(abs(float(curvature[tight])), 1e-9)) < least:
    log.warning(
      "%s: turns with a radius of %.2g m at %.3g m along it, where the QCar's tightest is %.2g m; it will leave the"
      " path there. Smooth the points, or take fewer",
      file, radius, grid[tight], least,
    )  # fmt: skip
  arrays = [grid, x, y, np.unwrap(np.arctan2(dy, dx)), curvature]
  for array in arrays:
    array.flags.writeable = False
  return Path(FilePath(file).stem, *arrays, closed=closed)


def _points(file: FilePath) -> Array:
  """Rows of a file, (k, 2), m."""
  rows: list[tuple[float, float]] = []
  names: list[str] | None = None
  columns, scales = (0, 1), (1.0, 1.0)
  for number, line in enumerate(read_text(file).splitlines(), start=1):
    cells = [cell.strip() for cell in re.split(r"[;,\t]", line.lstrip("# "))]
    cells = line.split() if len(cells) == 1 else cells
    if not line.strip():
      continue
    if not rows and (line.startswith("#") or not _is_number(cells[0])):
      names = cells if len(cells) > 1 else names
      continue
    if line.startswith("#"):
      continue
    if not rows:
      columns, scales = _columns(file, names, len(cells))
    try:
      x, y = (scale * float(cells[i]) for i, scale in zip(columns, scales, strict=True))
    except (IndexError, ValueError):
      raise ValueError(f"{file}: row {number} is not x, y in m: '{line[:40]}'; two numbers, a comma between") from None
    if not (math.isfinite(x) and math.isfinite(y)):
      raise ValueError(f"{file}: row {number} is not finite; leave it out, the path goes on to the next point")
    if rows and math.hypot(x - rows[-1][0], y - rows[-1][1]) < 1e-9:
      raise ValueError(f"{file}: row {number} repeats the point before it; leave it out")
    rows.append((x, y))
  if len(rows) < 4:
    raise ValueError(f"{file}: {len(rows)} points; a path needs at least four, as two columns x, y in m")
  return _of_a_floor(file, np.array(rows))


def _columns(file: FilePath, names: list[str] | None, count: int) -> tuple[tuple[int, int], tuple[float, float]]:
  """Which columns are x and y, and their factors to m, by the names before the numbers; the only two without names."""
  cure = "give a line of names with x and y, such as x [m],y [m]"
  if names is None or len(names) != count:
    if count != 2:
      raise ValueError(f"{file}: has {count} columns and no names for them; {cure}")
    return (0, 1), (1.0, 1.0)
  of = lambda axis: [i for i, name in enumerate(names) if axis in words_of(name)]
  x, y = of("x"), of("y")
  if len(x) != 1 or len(y) != 1:
    raise ValueError(f"{file}: its columns are {', '.join(names)[:80]}, of which not one is x and one y; {cure}")
  units = [unit_of(names[i]) for i in (x[0], y[0])]
  if wrong := [unit[0] for unit in units if unit and unit[1] != "m"]:
    raise ValueError(f"{file}: x and y are in {wrong[0]}; a path is in m, cm, mm, km or inches")
  factors = [unit[2] if unit else 1.0 for unit in units]
  return (x[0], y[0]), (factors[0], factors[1])


def _of_a_floor(file: FilePath, points: Array) -> Array:
  """Points (k, 2), m, as they are. Raises ValueError where they are those of a map, or of another unit."""
  apart = float(np.median(np.hypot(*np.diff(points, axis=0).T)))
  if apart > FARTHEST:
    raise ValueError(f"{file}: neighbouring points are {apart:.3g} m apart; name the unit, as in x [mm],y [mm]")
  if np.abs(points).max() > EDGE:
    raise ValueError(
      f"{file}: lies {np.abs(points).max():.3g} m from the origin, where positions lose their last digits;"
      " take its first point off all points"
    )
  return points


def _is_number(text: str) -> bool:
  try:
    float(text)
  except ValueError:
    return False
  return True
