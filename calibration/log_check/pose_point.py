"""How sensors sit: which point of the car a pose is of, by how it moves sideways in turns; an IMU upside down, a place
that is mirrored."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.log_check.causes import ALIKE, FACTOR
from calibration.log_check.disagreements import Finding
from calibration.log_check.pairs import Comparison, jackknife_std
from qcar_twin.recordings.completed import heading_or_course
from qcar_twin.recordings.first_dataset.scales.series import correlation
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
_OFF = 0.142  # rad, whose cosine is 0.99: the 1 % that a sensor's scale may be off
_SECOND, _COURSES = 1.0, 20  # s, over which a path turns by more than its noise, and how many of these say anything
_DENSE = 0.8  # of the directions a second has, without a stop


def pose_point_findings(recordings: Sequence[Recording], vehicle: Vehicle) -> list[Finding]:
  """That pose_x and pose_y are of a point far ahead of the centre of gravity, or far behind it."""
  blocks = [block for r in recordings for block in _blocks(r)]
  if len(blocks) >= _LEAST and (askew := _askew(*_solved(blocks, 2))):
    return askew
  if len(blocks) < _LEAST or np.sqrt(np.mean(np.concatenate(blocks)[:, 1] ** 2)) < _TURNS:
    return []
  ahead, std = _solved(blocks, 0)
  ahead -= vehicle.cg_to_rear
  if abs(ahead) - _SURE * std < _ELSEWHERE * vehicle.wheelbase:
    return []
  where = "ahead of" if ahead > 0.0 else "behind"
  said = f"pose_x and pose_y are of a point {abs(ahead):.3f} ± {std:.3f} m {where} the centre of gravity: so they move"
  cure = f"set ahead = {ahead:.3f} on pose_x in [channels], added to one that is there"
  return [Finding("beware", ("pose_x", "pose_y"), f"{said} sideways in turns; {cure}")]


def upside_down_findings(comparisons: Sequence[Comparison], placed: bool = True) -> list[Finding]:
  """That gyro and lateral accelerometer agree, and both turn against the pose: one mount, not two signs.

  An IMU turned over about the car's long axis changes the sign of both. A mirrored place does, too, for them: the
  steering says which of the two it is, where it goes with one of them.

  Args:
    placed: a place was logged; a heading alone may be a compass's, which counts clockwise.
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
  turned = ("pose_y", "pose_yaw") if placed else ("pose_yaw",)
  place = "the place is mirrored" if placed else "the heading counts clockwise, as a compass does"
  place += f": set scale = -1 on {' and on '.join(turned)} in [channels], times those that are there"
  with_imu = 0.0 if steered is None else steered.correlation
  if with_imu < -ALIKE:
    cure, channels = f"the steering goes with the pose: {imu}", ("yaw_rate", "accel_y")
  elif with_imu > ALIKE:
    channels = turned
    cure = f"the steering goes with them: {place}; or, with scale = -1 on steering_command, too, {imu}"
  else:
    cure, channels = f"{imu}; or {place}", ("yaw_rate", "accel_y", *turned)
  return [Finding("spoils", channels, f"{said}; {cure}")]


def mirrored_findings(recordings: Sequence[Recording]) -> list[Finding]:
  """That a path, whose heading was not logged, turns to the other side than the gyro says, or much further or less.

  Its direction is what the heading is but for the sideslip, which over a second of gentle driving is small beside what
  a car turns by.
  """
  parts = [turns for r in recordings if (turns := _turns(r)) is not None]
  turned, path = np.concatenate([*parts, np.empty((2, 0))], axis=1)
  alike = correlation(turned, path, _COURSES)
  if alike > ALIKE and not 1.0 / FACTOR <= (ratio := float(np.std(turned) / np.std(path))) <= FACTOR:
    cure = (
      f"set scale = {1.0 / ratio:.4g} on yaw_rate in [channels], times one that is there; or the clock's scale is off"
    )
    return [Finding("spoils", ("yaw_rate",), f"yaw_rate turns {ratio:.3g} times as far as the path does: {cure}")]
  if alike > -ALIKE:
    return []
  with_it = [name for name in ("steering_command", "accel_y") if any(name in r for r in recordings)]
  also = f", and on {' and '.join(with_it)} where it goes with the gyro" if with_it else ""
  cure = f"set scale = -1 on pose_y where the place is mirrored, else on yaw_rate{also}, in [channels]"
  said = "yaw_rate says the contrary of how the path of pose_x and pose_y turns: one of them has the wrong sign"
  return [Finding("spoils", ("yaw_rate", "pose_x", "pose_y"), f"{said}; {cure}")]


def _turns(recording: Recording) -> Array | None:
  """What the gyro and the path's direction turn by, (2, k), rad, over seconds in which the car moved on."""
  if not {"yaw_rate", "pose_x", "pose_y"} <= set(recording.channels) or "pose_yaw" in recording:
    return None
  course, gyro = heading_or_course(recording), recording["yaw_rate"]
  if course is None or len(gyro) < 2:
    return None
  begin = np.arange(max(course.time[0], gyro.time[0]), min(course.time[-1], gyro.time[-1]) - _SECOND, _SECOND)
  steps = np.diff(gyro.time, prepend=gyro.time[0]) * gyro.value
  angle = np.interp(np.stack([begin, begin + _SECOND]), gyro.time, np.cumsum(steps))
  path = np.interp(np.stack([begin, begin + _SECOND]), course.time, course.value)
  count = np.searchsorted(course.time, begin + _SECOND) - np.searchsorted(course.time, begin)
  told = count >= _DENSE * _SECOND / np.median(np.diff(course.time))
  return np.stack([np.diff(angle, axis=0)[0], np.diff(path, axis=0)[0]])[:, told]


def _askew(off: float, std: float) -> list[Finding]:
  """That the car goes straight on at an angle to its heading."""
  if abs(off) - _SURE * std < _OFF:
    return []
  side = "right" if off > 0.0 else "left"
  said = (
    f"pose_yaw points {abs(off):.3f} ± {std:.3f} rad to the {side} of where the car goes straight on, so that a speed"
  )
  cure = f"set offset = {off:.4g} on pose_yaw in [channels], added to one that is there"
  return [Finding("beware", ("pose_yaw",), f"{said} along it is {100.0 * (1.0 - np.cos(off)):.0f} % less; {cure}")]


def _solved(blocks: Sequence[Array], which: int) -> tuple[float, float]:
  """How far the pose's point lies before the rear axle, m (`which` 0), or the heading points to the right of the way,
  rad (2), and the standard deviation, by leaving out block by block.

  A point a m before the axle moves sideways with v_y = a r - k v^2 r + e v: the rear tyres slip by k times v r, and the
  heading is off by e.
  """
  products = np.stack([rows.T @ rows for rows in blocks])
  solve = lambda p: float(np.linalg.lstsq(p[1:, 1:], p[1:, 0], rcond=None)[0][which])
  whole = products.sum(axis=0)
  value, std = solve(whole), float(jackknife_std(np.array([solve(whole - one) for one in products])))
  return (float(np.arctan(value)), std) if which == 2 else (value, std)


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
