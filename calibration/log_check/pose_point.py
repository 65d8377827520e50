"""How sensors sit: which point of the car a pose is of, by how it moves sideways in turns; an IMU upside down."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.log_check.causes import ALIKE
from calibration.log_check.disagreements import Finding
from calibration.log_check.pairs import Comparison
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_WINDOW = 0.2  # s, over which the pose's way is taken: a millimetre is 5 mm/s then
_BLOCK = 25  # windows, 5 s, that share whatever disturbs them
_LEAST = 8  # blocks, from which a deviation can be told
_SLOWEST, _GENTLE = 0.2, 2.0  # m/s, m/s^2 across: tyres slip in proportion to what they give
_TURNS = 0.3  # rad/s, root mean square: a heading known to 0.02 rad, as a lidar's, then takes a fifth off a distance
_ELSEWHERE = 0.2  # of the wheelbase: a marker is put on the middle of a car by eye; an axle is half a wheelbase away
_SURE = 4.0  # standard deviations


def pose_point_findings(recordings: Sequence[Recording], vehicle: Vehicle) -> list[Finding]:
  """That pose_x and pose_y are of a point far ahead of the centre of gravity, or far behind it."""
  blocks = [block for r in recordings for block in _blocks(r)]
  if len(blocks) < _LEAST or np.sqrt(np.mean(np.concatenate(blocks)[:, 1] ** 2)) < _TURNS:
    return []
  ahead, std = _ahead(blocks)
  ahead -= vehicle.cg_to_rear
  if abs(ahead) - _SURE * std < _ELSEWHERE * vehicle.wheelbase:
    return []
  where, sign = ("ahead of", "-") if ahead > 0.0 else ("behind", "+")
  said = f"pose_x and pose_y are of a point {abs(ahead):.3f} ± {std:.3f} m {where} the centre of gravity: so they move"
  shift = " and ".join(f"{sign} {abs(ahead):.3f} {part}(pose_yaw)" for part in ("cos", "sin"))
  cure = f"track that centre, or add {shift} to the two columns, in m, before a fit"
  return [Finding("beware", ("pose_x", "pose_y"), f"{said} sideways in turns; {cure}")]


def upside_down_findings(comparisons: Sequence[Comparison]) -> list[Finding]:
  """That gyro and lateral accelerometer agree, and both turn against the pose: one mount, not two signs.

  An IMU turned over about the car's long axis changes the sign of both. A mirrored place does, too, for them: the
  steering says which of the two it is, where it goes with one of them.
  """
  turning, across, steered = (
    next(
      (c for c in comparisons if not c.why_not and c.motion.compared == (name,) and other in c.motion.reference), None
    )
    for name, other in (("yaw_rate", "pose_yaw"), ("accel_y", "yaw_rate"), ("yaw_rate", "steering_command"))
  )
  if turning is None or across is None or turning.correlation > -ALIKE or across.correlation < ALIKE:
    return []
  said = "yaw_rate and accel_y agree with each other, and both say the contrary of the pose's turning"
  imu = "the IMU lies upside down: set scale = -1 on yaw_rate and on accel_y in [channels], times those that are there"
  place = "the place is mirrored: set scale = -1 on pose_y and on pose_yaw in [channels], times those that are there"
  with_imu = 0.0 if steered is None else steered.correlation
  if with_imu < -ALIKE:
    cure, channels = f"the steering goes with the pose: {imu}", ("yaw_rate", "accel_y")
  elif with_imu > ALIKE:
    channels = ("pose_y", "pose_yaw")
    cure = f"the steering goes with them: {place}; or, with scale = -1 on steering_command, too, {imu}"
  else:
    cure, channels = f"{imu}; or {place}", ("yaw_rate", "accel_y", "pose_y", "pose_yaw")
  return [Finding("spoils", channels, f"{said}; {cure}")]


def _ahead(blocks: Sequence[Array]) -> tuple[float, float]:
  """How far the pose's point lies before the rear axle, m, and the standard deviation, by leaving out block by block.

  A point a m before the axle moves sideways with v_y = a r - k v^2 r + e v: the rear tyres slip by k times v r, and the
  heading is off by e.
  """
  products = np.stack([rows.T @ rows for rows in blocks])
  solve = lambda p: float(np.linalg.lstsq(p[1:, 1:], p[1:, 0], rcond=None)[0][0])
  whole = products.sum(axis=0)
  each = np.array([solve(whole - one) for one in products])
  count = len(blocks)
  return solve(whole), float(np.sqrt((count - 1) / count * np.sum((each - each.mean()) ** 2)))


def _blocks(recording: Recording) -> list[Array]:
  """Of windows in which the car drives gently: v_y, r, v^2 r and v, (k, 4), m and s, in pieces of five seconds."""
  if not {"pose_x", "pose_y", "pose_yaw"} <= set(recording.channels) or "pose_yaw" in recording.derived:
    return []
  time = np.arange(recording["pose_x"].time[0], recording["pose_x"].time[-1], _WINDOW)
  if time.size < 2:
    return []
  x, y, yaw = (recording[name].interpolate(time) for name in ("pose_x", "pose_y", "pose_yaw"))
  middle = recording["pose_yaw"].interpolate(0.5 * (time[1:] + time[:-1]))
  east, north, turn = (np.diff(values) / _WINDOW for values in (x, y, yaw))
  along, across = np.cos(middle) * east + np.sin(middle) * north, np.cos(middle) * north - np.sin(middle) * east
  rows = np.stack([across, turn, along**2 * turn, along], axis=1)
  told = np.isfinite(rows).all(axis=1) & (np.abs(along) > _SLOWEST) & (np.abs(along * turn) < _GENTLE)
  pieces = [rows[k : k + _BLOCK][told[k : k + _BLOCK]] for k in range(0, len(rows), _BLOCK)]
  return [piece for piece in pieces if len(piece)]
