"""What vectors say whose elements have no names: three along axes, or a place on the floor and a heading; MuJoCo's
generalised coordinates of a car whose body hangs on a free joint.

Of such a joint `qpos` has the place, m, and the quaternion, w first; `qvel` the velocity along the world's axes, m/s,
and the turning about the body's own, rad/s. Source: MuJoCo's documentation, "Computation", floating objects.
"""

from __future__ import annotations

import numpy as np

from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import words_of

_UNIT, _LEVEL = 0.01, 0.2  # how far from 1 a quaternion's squared length is at most; roll and pitch, half of an angle
# words of vectors whose elements, though they be three, are no axes
_NO_AXES = {
  "ctrl", "action", "actions", "qpos", "qvel", "joint", "joints", "wheel", "wheels", "motor", "motors", "servo",
  "servos",
}  # fmt: skip
_POSES = {"pose", "poses"}
_TURNED = 1.0  # rad, that a heading has to vary by to be told from a height by the path
_ALONG = 0.9  # mean length of unit vectors, from which a heading goes with the path's direction: 25 deg apart


def axes_of(name: str, elements: np.ndarray) -> tuple[str, str, str] | None:
  """What the three elements of a vector, (3, rows), are called behind its name: x, y and z; of a pose on the floor x,
  y and yaw. None where the name says that they are no axes."""
  words = set(words_of(name))
  if words & _NO_AXES:
    return None
  return ("x", "y", "yaw") if words & _POSES and _is_heading(*elements) else ("x", "y", "z")


def _is_heading(x: np.ndarray, y: np.ndarray, third: np.ndarray) -> bool:
  """Whether the third of three columns is a heading, rad: it stays within half a turn, and jumps from one end to the
  other or goes with the path, forwards or backwards, as no height does."""
  there = np.isfinite(x) & np.isfinite(y) & np.isfinite(third)
  x, y, third = x[there], y[there], third[there]
  if third.size < 2 or np.abs(third).max() > np.pi + _UNIT:
    return False
  if np.abs(np.diff(third)).max() > np.pi:
    return True
  steps = np.flatnonzero(np.hypot(np.diff(x), np.diff(y)) > 0.0)
  course = np.arctan2(np.diff(y), np.diff(x))[steps]
  way = np.hypot(np.diff(x), np.diff(y))[steps]
  if not steps.size or np.ptp(third) < _TURNED:
    return False
  alike = np.average(np.exp(2j * (course - third[steps])), weights=way)
  return bool(np.abs(alike) > _ALONG > np.abs(np.average(np.exp(2j * course), weights=way)))


def of_a_free_joint(table: Table) -> dict[str, np.ndarray]:
  """Place, yaw, speed along the car and yaw rate of the first body, (rows,) each; nothing where `qpos` and `qvel` do
  not begin with a free joint of a car on a floor."""
  names = [f"qpos[{k}]" for k in range(7)], [f"qvel[{k}]" for k in range(6)]
  if not all(name in table for each in names for name in each):
    return {}
  try:
    place, moved = (np.stack([table.number(name, name) for name in each]) for each in names)
  except RecordingError:
    return {}
  w, x, y, z = place[3:]
  off = np.abs(np.sum(place[3:] ** 2, axis=0) - 1.0)
  if not (np.isfinite(place).all() and np.isfinite(moved).all() and off.max() < _UNIT):
    return {}
  if np.abs(np.hypot(x, y)).max() > _LEVEL:
    return {}
  yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2))
  return {
    "qpos.position.x": place[0],
    "qpos.position.y": place[1],
    "qpos.yaw": yaw,
    "qvel.speed [m/s]": moved[0] * np.cos(yaw) + moved[1] * np.sin(yaw),
    "qvel.yaw rate [rad/s]": moved[5],
  }
