"""Motion that the drive's command explains nothing of: a car that was pushed, towed or carried, or that rolled down.
And wheels that turned while the car stood, on a stand or in the air.

With nothing commanded a car on a level floor only slows down. How far it may speed up all the same is physics: a floor
inclined by a few degrees pulls with g sin of the angle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.checks.acted import Stretch
from qcar_twin.recordings.checks.driving import MOVING, PERIOD, Drive, driven, runs, smoothed
from qcar_twin.recordings.checks.units import Bins, travel_of
from qcar_twin.recordings.recording import Recording, RecordingError

_LONGEST_LAG = 0.5  # s, for which a drive may go on after its command ended, or before the next, stamped late
_SLOPE = 9.81 * np.sin(np.radians(3.0))  # m/s^2: floors of rooms and yards are inclined by less (5 %)
_RISE = 0.3  # s, over which that is asked of the speed: a bump, or a wheel that gets its grip back, takes less
_SMOOTH = 5  # rows of the grid in a mean of the speed, 0.25 s
_SURE = 5.0  # deviations of such a mean: a drive has a thousand of them
_WITNESSED = 0.5  # of the rise that another sensor shows, or that is lost again: halfway between all and nothing
_PATH = 0.2  # s, over which a path's speed is taken
_LEAST = 20  # bins, over which wheels and forces are compared, that tell
# times what is felt, from which wheels speed up and the car does not, whatever their radius; m/s^2 that any drive takes
_TIMES, _DRIVEN = 5.0, 0.3
_TURNS, _SPAN, _UNLIKE = 0.05, 0.3, 0.3  # rad/s and m within which a car stands, and correlation of force with wheels


def pushed_stretches(recordings: Sequence[Recording], channel: str, scale: float = 1.0) -> list[Stretch]:
  """Stretches in which a car moves under a command of 0 as none does by itself, in order.

  It stood, drove off and stopped again; or it rolled and sped up by more than a slope of a few degrees does. Before
  them the command was 0 for longer than any drive goes on after it.

  Args:
    scale: m/s per unit of the measured speed.
  """
  held = driven(recordings, channel)
  top = max((float(np.percentile(np.abs(d.speed), 99.0)) for d in held), default=0.0)
  stretches = []
  for d in held:
    whole = _from_rest(d, top)
    for first, last in _sped_up(d, top, scale):
      if not any(first <= b and a <= last for a, b in whole):  # else it is in what was said
        whole.append((first, last))
    stretches += [Stretch(d.recording, channel, float(d.time[a]), float(d.time[b])) for a, b in sorted(whole)]
  return stretches


def _from_rest(d: Drive, top: float) -> list[tuple[int, int]]:
  """First and last row of what begins and ends at rest."""
  lag, parts = round(_LONGEST_LAG / PERIOD), []
  fast = smoothed(np.abs(d.speed), _SMOOTH) > MOVING * top
  for first, last, off in runs(d.command == 0.0):
    if not off or not d.rest[first + lag : last + 1].any():
      continue
    begin = first + lag + int(np.argmax(d.rest[first + lag : last + 1]))
    for start, stop, moves in runs(~d.stands[begin : last + 1]):
      ended = begin + stop < last or last == d.time.size - 1  # else the command came late, and is no 0 in truth
      if moves and start > 0 and ended and fast[begin + start : begin + stop + 1].any():
        parts.append((begin + start, begin + stop))
  return parts


def _sped_up(d: Drive, top: float, scale: float) -> list[tuple[int, int]]:
  """First and last row of rises of the speed, by a share of the top speed that is driving and beyond noise, which
  another sensor shows, too, where there is one: wheels that get their grip back rise alone."""
  count, lag = round(_RISE / PERIOD), round(_LONGEST_LAG / PERIOD)
  if d.speed.size <= max(count, _SMOOTH):
    return []
  padded = np.pad(d.speed, _SMOOTH // 2, mode="edge")
  signed = np.convolve(padded, np.full(_SMOOTH, 1.0 / _SMOOTH), "valid")
  speed = np.abs(signed)
  noise = 1.4826 * float(np.median(np.abs(d.speed - signed))) / np.sqrt(_SMOOTH)
  least = max(MOVING * top, _SURE * np.sqrt(2.0) * noise)
  hasty = scale * (speed[count:] - speed[:-count]) > _SLOPE * _RISE
  parts = []
  for first, last, off in runs(d.command == 0.0):
    begin, end = first + lag, last + 1 if last == d.time.size - 1 else last + 1 - lag
    if not off or end - begin <= count:
      continue
    for start, stop, rises in runs(hasty[begin : end - count]):
      a, b = begin + start, begin + stop + count
      rise = float(speed[b] - speed[a])
      slows = last == d.time.size - 1 or speed[b : last + 1].min() < speed[b] - _WITNESSED * rise
      if not rises or rise < least or not slows:  # what goes on until a command came is the answer to a late one
        continue
      if _witnessed(d, a, b, float(np.sign(signed[b])), scale * rise):
        parts.append((a, b))
  return parts


def _witnessed(d: Drive, first: int, last: int, way: float, rise: float) -> bool:
  """Whether the acceleration along or the path shows a rise in m/s, too; yes where there is neither."""
  start, end = float(d.time[first]), float(d.time[last])
  shown = [s for s in (_felt(d.recording, start, end, way), _along_the_path(d.recording, start, end)) if s is not None]
  return not shown or max(shown) > _WITNESSED * rise


def _felt(recording: Recording, start: float, end: float, way: float) -> float | None:
  """What the accelerometer adds up to, m/s, in the sense of the motion."""
  if "accel_x" not in recording:
    return None
  stream = recording["accel_x"]
  inside = (stream.time >= start) & (stream.time <= end)
  return way * float(np.mean(stream.value[inside])) * (end - start) if inside.any() else None


def _along_the_path(recording: Recording, start: float, end: float) -> float | None:
  """By how much the path's speed rises, m/s."""
  if not {"pose_x", "pose_y"} <= set(recording.channels):
    return None
  x, y = recording["pose_x"], recording["pose_y"]
  if not (x.time[0] <= start - 0.5 * _PATH and end + 0.5 * _PATH <= x.time[-1]):
    return None
  edges = np.array([[start - 0.5 * _PATH, start + 0.5 * _PATH], [end - 0.5 * _PATH, end + 0.5 * _PATH]])
  moved = np.hypot(*(np.diff(np.interp(edges, s.time, s.value), axis=1)[:, 0] for s in (x, y)))
  return float(moved[1] - moved[0]) / _PATH


def without_lifted(
  recordings: Sequence[Recording], vehicle: Mapping[str, float | str]
) -> tuple[list[Recording], list[str]]:
  """The recordings without those in which the wheels turned and the car stood, and a note on each.

  Args:
    vehicle: numbers of the car, by which a motor's speed is one over ground.

  Raises:
    RecordingError: no other recording is left.
  """
  lifted = [r for r in recordings if is_lifted(r, travel_of(vehicle))]
  said = (
    "the wheels speed up and slow down, and neither accelerometer nor gyro nor place moves: the car stood, with its"
  )
  notes = [f"{r.file or r.name}: {said} wheels in the air" for r in lifted]
  if notes and len(lifted) == len(recordings):
    raise RecordingError(f"{notes[0]}; give recordings of a car that drives")
  return [r for r in recordings if r not in lifted], [f"{note}; it is left out" for note in notes]


def is_lifted(recording: Recording, travel: float) -> bool:
  """Whether wheels speed up and slow down in a recording and nothing else moves. Either accelerometer tells: an IMU may
  lie with its y axis along the car.

  Args:
    travel: m per rad of the motor, for logs without a speed.
  """
  has, bins = set(recording.channels) - set(recording.derived), Bins(recording)
  name = "speed" if "speed" in has else "motor_speed"
  forces = [bins.mean(axis) for axis in ("accel_x", "accel_y") if axis in has]
  if name not in has or not forces or not has & {"yaw_rate", "pose_x"}:
    return False
  gained = bins.change(name) * (travel if name == "motor_speed" else 1.0)
  both = np.isfinite(gained) & np.isfinite(forces).all(axis=0)
  felt = [force[both] for force in forces]
  if both.sum() < _LEAST or not np.std(gained[both]) > max(_TIMES * max(map(np.std, felt)), _DRIVEN):
    return False
  if "yaw_rate" in has and np.nanstd(bins.mean("yaw_rate")) > _TURNS:
    return False
  if any(np.ptp(recording[place].value) > _SPAN for place in ("pose_x", "pose_y") if place in has):
    return False
  moved = [force for force in felt if np.ptp(force) > 0.0]
  return all(abs(float(np.corrcoef(gained[both], force)[0, 1])) < _UNLIKE for force in moved)
