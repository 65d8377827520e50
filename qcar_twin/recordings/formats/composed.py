"""Columns that others make up, as ROS writes them into text: a stamp of seconds and nanoseconds, a quaternion. Numbers
with their unit in every cell."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable

import numpy as np

from qcar_twin.recordings.formats.axles import axle_means
from qcar_twin.recordings.formats.generalised import of_a_free_joint
from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import ELEMENT, VECTORS, unit_of, words_of

_SECONDS = re.compile(r"^(?P<stamp>.*?)[._ /]?(?P<s>secs?)$", re.IGNORECASE)
_NANOSECONDS = ("nsec", "nsecs", "nanosec", "nanosecs")
_QUATERNION = re.compile(
  r"^(?P<stem>.*(?:orientation|orient|rotation|attitude|quaternion|quat|q))(?P<gap>[._ /]?)(?P<w>w)$", re.IGNORECASE
)
_LIST = re.compile(r"^\s*[\[(](?P<inside>.*)[\])]\s*$", re.DOTALL)
_WITH_UNIT = re.compile(r"^\s*(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>[^\s\d.,:;+-].*?)\s*$")
_MOST = 16  # elements of a cell that are columns
_INDEXED = re.compile(r"^(?P<stem>.+?)[._ ]?(?P<place>\d)$")
_LATITUDES, _LONGITUDES = {"lat", "latitude"}, {"lon", "lng", "longitude"}
_FIX = re.compile(r"^\s*(?P<latitude>-?\d{1,2}\.\d+)[\s,;]+(?P<longitude>-?\d{1,3}\.\d+)\s*$")
_RECEIVERS = {"gps", "gnss"}
_POLE, _APART = 90.0, 0.5  # degrees of latitude, and between places of one drive
_EQUATOR, _ECCENTRICITY = 6378137.0, 6.69437999014e-3  # m, and squared, of WGS 84
_ABOUT = 5.0  # times what it turns about another axis, from which a car turns about one: it pitches by 0.1 rad at most
_ROTATIONS = {"quat", "quaternion", "orientation", "orient", "rotation", "attitude", "q"}
# the elements of a quaternion that stay small of a car on a floor -> w, and the one that turns
_PLANAR = {(1, 2): (0, 3), (0, 1): (3, 2), (0, 2): (3, 1), (1, 3): (0, 2)}  # z or y upwards, w first or last
_IMUS, _GRAVITIES, _NEAR = {"imu"}, (9.80665, 1.0), 0.1  # m/s^2 and g, and how near a reading of it is
_UPRIGHT = 0.8  # of gravity, which an upright axis feels: a mount tilted by 37 deg
_UNIT = 0.01  # how far from 1 the squared length of a quaternion of rotation usually is at most, by its digits
_NOISY = 0.1  # and how far it ever is, where its parts were filtered one by one


def parts_of_others(names: Iterable[str]) -> set[str]:
  """Columns that are parts of a stamp or of a quaternion, and no channel of their own."""
  names = tuple(names)
  stamps = {part for whole, (rest, _) in _stamps(names).items() for part in (whole, rest)}
  quaternions = {part for parts in (*_quaternions(names).values(), *_flat(names).values()) for part in parts}
  return stamps | quaternions | set(_elements(names).values())


def _stamps(names: Iterable[str]) -> dict[str, tuple[str, str]]:
  """Columns that have whole seconds of a stamp, as ROS writes them -> the column of its nanoseconds, and its name."""
  names, parts = tuple(names), {}
  for name in names:
    if (parsed := _SECONDS.match(name)) is None:
      continue
    stem = name[: len(name) - len(parsed["s"])]
    other = next((n for n in names if n.startswith(stem) and n[len(stem) :].lower() in _NANOSECONDS), None)
    if other is not None:
      parts[name] = (other, parsed["stamp"] or "stamp")
  return parts


def _quaternions(names: Iterable[str]) -> dict[str, tuple[str, str, str, str]]:
  """What the yaw of each quaternion is called -> its columns w, x, y and z."""
  names, out = tuple(names), {}
  for parsed in filter(None, map(_QUATERNION.match, names)):
    stem = parsed["stem"] + parsed["gap"]
    w, x, y, z = (f"{stem}{axis}" for axis in ("WXYZ" if parsed["w"] == "W" else "wxyz"))
    if {w, x, y, z} <= set(names):
      out[f"{parsed['stem']}{parsed['gap'] or '_'}yaw"] = (w, x, y, z)
  return out


def _flat(names: Iterable[str]) -> dict[str, tuple[str, str]]:
  """What the yaw of each quaternion of a turn on the floor is called -> its columns w and z, where x and y were
  not logged."""
  names, out = tuple(names), {}
  for parsed in filter(None, map(_QUATERNION.match, names)):
    stem = parsed["stem"] + parsed["gap"]
    w, x, y, z = (f"{stem}{axis}" for axis in ("WXYZ" if parsed["w"] == "W" else "wxyz"))
    if z in names and not {x, y} & set(names):
      out[f"{parsed['stem']}{parsed['gap'] or '_'}yaw"] = (w, z)
  return out


def _lists(table: Table) -> dict[str, np.ndarray]:
  """The elements of cells that hold a list each, as Python writes an array of three into a cell: `gyro.x` to `gyro.z`,
  else by their number."""
  out = {}
  for name, cells in table.columns.items():
    there = [k for k, cell in enumerate(cells) if cell is not None] if cells.dtype == object else []
    rows = [_LIST.match(str(cells[k])) for k in there]
    if not rows or not all(rows):
      continue
    split = [row["inside"].replace(",", " ").split() for row in rows if row]
    count = len(split[0])
    try:
      numbers = np.array(split, dtype=float)
    except ValueError:
      continue
    if not 2 <= count <= _MOST or numbers.shape != (len(there), count):
      continue
    names = [f"{name}.{axis}" for axis in "xyz"] if count == 3 else [f"{name}[{k}]" for k in range(count)]
    for element, values in zip(names, numbers.T, strict=True):
      out[element] = np.full(cells.size, np.nan)
      out[element][there] = values
  return out


def _with_units(table: Table) -> dict[str, np.ndarray]:
  """The numbers of columns whose cells have a unit behind each, one and the same, which goes into the name:
  `speed [m/s]` of cells such as `0.35 m/s`."""
  out = {}
  for name, cells in table.columns.items():
    there = [k for k, cell in enumerate(cells) if cell is not None] if cells.dtype == object else []
    parsed = [_WITH_UNIT.match(str(cells[k])) for k in there]
    units = {match["unit"] if match else "" for match in parsed}
    if len(units) != 1 or "" in units or unit_of(f"[{min(units)}]") is None:
      continue
    whole = f"{name} [{min(units)}]"
    out[whole] = np.full(cells.size, np.nan)
    out[whole][there] = [float(match["number"]) for match in parsed if match]
  return out


def _elements(names: Iterable[str]) -> dict[str, str]:
  """What the elements 0, 1 and 2 of a vector of three are called as such, `gyro[2]` -> their columns, `gyro_2`."""
  vectors: dict[str, dict[str, str]] = {}
  for name in names:
    if (parsed := _INDEXED.match(name)) is not None and set(words_of(parsed["stem"])) & VECTORS:
      vectors.setdefault(parsed["stem"], {})[parsed["place"]] = name
  whole = {stem: parts for stem, parts in vectors.items() if parts.keys() == set("012")}
  return {f"{stem}[{place}]": name for stem, parts in whole.items() for place, name in parts.items()}


def of_cells(table: Table) -> dict[str, np.ndarray]:
  """Columns of numbers, (rows,), from cells that hold more than a number: lists, and numbers with their unit."""
  return {**_lists(table), **_with_units(table), **_fixes(table)}


def _fixes(table: Table) -> dict[str, np.ndarray]:
  """Latitude and longitude of cells that hold both, as radios write what a receiver says: `47.38911 8.61210`."""
  out = {}
  for name, cells in table.columns.items():
    there = [k for k, cell in enumerate(cells) if cell is not None] if cells.dtype == object else []
    rows = [_FIX.match(str(cells[k])) for k in there]
    if not rows or not all(rows) or not set(words_of(name)) & _RECEIVERS:
      continue
    for what in ("latitude", "longitude"):
      out[f"{name}.{what}"] = np.full(cells.size, np.nan)
      out[f"{name}.{what}"][there] = [float(row[what]) for row in rows if row]
  return out


def composed(table: Table) -> Table:
  """The table with one column, in s, for every stamp that was written as seconds and nanoseconds, one, in rad, for the
  yaw of every quaternion, those of vectors under names that say their axis, be they in cells of lists, those of
  numbers with their unit, the mean of an axle's wheels, and what MuJoCo's coordinates say of a car."""
  made = {name: values for name, values in of_cells(table).items() if name not in table}
  for seconds, (nanoseconds, name) in _stamps(table.columns).items():
    if name not in table and (parts := _numbers(table, (seconds, nanoseconds))) is not None:
      made[name] = parts[0] + 1e-9 * parts[1]
  for yaw, names in _quaternions(table.columns).items():
    parts = _numbers(table, names)
    if parts is not None and yaw not in table and _of_rotations(parts):
      made[yaw] = _yaw(*parts)
  for yaw, names in _flat(table.columns).items():
    parts = _numbers(table, names)
    if parts is not None and yaw not in table and _of_rotations(parts):
      w, z = parts
      made[yaw] = np.arctan2(2.0 * w * z, 1.0 - 2.0 * z**2)
  made |= {name: values for name, values in _of_vectors(table).items() if name not in table}
  for element, name in _elements(table.columns).items():
    if element not in table and name not in table.ambiguous and (parts := _numbers(table, (name,))) is not None:
      made[element] = parts[0]
  made |= axle_means(table)
  made |= {name: values for name, values in of_a_free_joint(table).items() if name not in table}
  if (place := _place(dataclasses.replace(table, columns={**table.columns, **made}))) is not None:
    made |= {name: values for name, values in place.items() if name not in table}
  blank = {name: np.flatnonzero(np.isnan(values)) for name, values in made.items()}
  return dataclasses.replace(table, columns={**table.columns, **made}, not_a_number={**table.not_a_number, **blank})


def _vectors(table: Table, count: int) -> dict[str, np.ndarray]:
  """The vectors of so many elements that columns hold one each, `quat[0]` and on, or `quat(1)`, (count, rows)."""
  places: dict[str, dict[int, str]] = {}
  for name in table.columns:
    if (parsed := ELEMENT.search(name)) is not None:
      places.setdefault(name[: parsed.start()], {})[int(parsed["zero"] or int(parsed["one"]) - 1)] = name
  whole = {
    stem: tuple(parts[k] for k in range(count)) for stem, parts in places.items() if set(parts) == set(range(count))
  }
  return {stem: values for stem, names in whole.items() if (values := _numbers(table, names)) is not None}


def _of_vectors(table: Table) -> dict[str, np.ndarray]:
  """What vectors whose elements have no names hold: the yaw, rad, of a quaternion of a car that goes on a floor, be its
  w first or last, and the axes of an IMU's accelerometers and gyros, told by which three feel gravity."""
  made: dict[str, np.ndarray] = {}
  for stem, values in _vectors(table, 4).items():
    turned = np.nanmax(np.abs(values), axis=1)
    least, next_least = sorted(int(k) for k in np.argsort(turned)[:2])
    small = (least, next_least)
    level = small in _PLANAR and _ABOUT * turned[list(small)].max() < np.delete(turned, small).min()
    if set(words_of(stem)) & _ROTATIONS and level and _of_rotations(values):
      w, about = _PLANAR[small]
      made[f"{stem}_yaw"] = np.arctan2(2.0 * values[w] * values[about], 1.0 - 2.0 * values[about] ** 2)
  for stem, values in _vectors(table, 6).items():
    medians = np.nanmedian(values, axis=1)
    felt = [_feels_gravity(three) for three in (medians[:3], medians[3:])]
    if set(words_of(stem)) & _IMUS and felt[0] != felt[1]:
      force = 0 if felt[0] else 3
      made |= {f"{stem}.acc.{axis}": values[force + k] for k, axis in enumerate("xyz")}
      made |= {f"{stem}.gyro.{axis}": values[3 - force + k] for k, axis in enumerate("xyz")}
  return made


def _feels_gravity(three: np.ndarray) -> bool:
  length = float(np.linalg.norm(three))
  upright = float(np.abs(three).max()) > _UPRIGHT * length
  return upright and any(abs(length / gravity - 1.0) < _NEAR for gravity in _GRAVITIES)


def _place(table: Table) -> dict[str, np.ndarray] | None:
  """`gps.east` and `gps.north`, m from the first fix, of the only columns of latitude and longitude in degrees; on the
  ellipsoid WGS 84, by its radii of curvature there."""
  pairs = [_saying(table, words) for words in (_LATITUDES, _LONGITUDES)]
  if [len(names) for names in pairs] != [1, 1]:
    return None
  parts = _numbers(table, (pairs[0][0], pairs[1][0]))
  if parts is None or np.nanmax(np.abs(parts[0])) > _POLE or np.nanmax(np.abs(parts[1])) > 2.0 * _POLE:
    return None
  fixed = np.isfinite(parts).all(axis=0) & (parts != 0.0).any(axis=0)  # receivers without a fix write zeros
  if not fixed.any() or np.ptp(parts[:, fixed], axis=1).max() > _APART:
    return None
  latitude, longitude = np.deg2rad(np.where(fixed, parts, np.nan))
  first = int(np.argmax(fixed))
  flattened = 1.0 - _ECCENTRICITY * np.sin(latitude[first]) ** 2
  meridian, normal = _EQUATOR * (1.0 - _ECCENTRICITY) / flattened**1.5, _EQUATOR / np.sqrt(flattened)
  east = normal * np.cos(latitude[first]) * (longitude - longitude[first])
  return {"gps.east": east, "gps.north": meridian * (latitude - latitude[first])}


def _saying(table: Table, words: set[str]) -> list[str]:
  """Columns with one of these words in their names; of several those that say it in full, else those that say nothing
  else: Lat_Acc is across the car."""
  names = [name for name in table.columns if set(words_of(name)) & words]
  full = {word for word in words if word.endswith("itude")}
  of_several = [name for name in names if set(words_of(name)) & full] or [n for n in names if len(words_of(n)) == 1]
  return names if len(names) == 1 else of_several


def _of_rotations(parts: np.ndarray) -> bool:
  """Whether quaternions, (2 or 4, rows), are rotations: of length 1 but for digits and noise."""
  off = np.abs(np.sum(parts**2, axis=0) - 1.0)
  return bool(np.nanmedian(off) < _UNIT and np.nanmax(off) < _NOISY)


def _yaw(w: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
  """Rotation about the upright axis, rad: z, or y where all turning is about y, as where y is counted upwards."""
  turned = [float(np.nanmax(np.abs(part))) for part in (x, y, z)]
  if turned[1] > _ABOUT * max(turned[0], turned[2]):
    return np.arctan2(2.0 * w * y, 1.0 - 2.0 * y**2)
  return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2))


def _numbers(table: Table, names: tuple[str, ...]) -> np.ndarray | None:
  """Columns of numbers, (names, rows); None where one is absent, holds words or nothing."""
  try:
    values = np.stack([table.number(name, name) for name in names])
  except RecordingError:
    return None
  return values if np.isfinite(values).any(axis=1).all() else None
