"""What MuJoCo's generalised coordinates say of a car whose body hangs on a free joint.

Of such a joint `qpos` has the place, m, and the quaternion, w first; `qvel` the velocity along the world's axes, m/s,
and the turning about the body's own, rad/s. Source: MuJoCo's documentation, "Computation", floating objects.
"""

from __future__ import annotations

import numpy as np

from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.recording import RecordingError

_UNIT, _LEVEL = 0.01, 0.2  # how far from 1 a quaternion's squared length is at most; roll and pitch, half of an angle


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
