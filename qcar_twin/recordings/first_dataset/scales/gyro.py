"""What a gyro of 16 bits counts in, by what else turned.

Data sheets give counts per deg/s at each range: 131 to 16.4 of InvenSense's (MPU-6000 register map, "FS_SEL"), 228.6 to
14.3 of ST's (L3GD20 and LSM6, 4.375 to 70 mdps a count). Neighbours differ by 2, so an accelerometer tells the range.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.checks.units import UNIT_CORRELATION, compare
from qcar_twin.recordings.first_dataset.columns import Columns, Guess
from qcar_twin.recordings.first_dataset.refine import recordings_of
from qcar_twin.recordings.recording import Recording
from qcar_twin.recordings.unit_names import unit_of

_PER_DEGREE = (131.0, 65.5, 32.8, 16.4, *(1e3 / m for m in (4.375, 8.75, 17.5, 35.0, 70.0)))  # counts per deg/s
_DEGREE = math.pi / 180.0
# factor to the nearest range: by a force half of the way to the next; by a heading less than between 131 and 114.3
_NEARNESS = {"accel_y": 1.4, "pose_yaw": 1.05}


def settle_gyro_counts(columns: Columns, guesses: Mapping[str, Guess], sizes: Mapping[str, float | str]) -> list[str]:
  """Scale a gyro without a unit, whose whole numbers are beyond any car's turning in rad/s and in deg/s, by the range
  whose counts the heading or the force across confirms; returns a question where two makers' are as near. Nothing
  changes where neither does.

  Args:
    sizes: of the car, by which a motor's speed is roughly one in m/s.
  """
  guess = guesses.get("yaw_rate")
  if guess is None or unit_of(guess.column) is not None or not _counted(columns, guess.column):
    return []
  as_it_is = Guess("yaw_rate", guess.column, hold=guess.hold)
  trial = {**guesses, "yaw_rate": as_it_is}
  for witness in ("pose_yaw", "accel_y"):
    slope = _slope(recordings_of(columns, trial), sizes, witness) if witness in guesses else None
    if slope is None:
      continue
    per_degree = _DEGREE / slope
    nearness = {counts: abs(math.log(per_degree / counts)) for counts in _PER_DEGREE}
    near = [c for c in sorted(nearness, key=lambda c: nearness[c]) if nearness[c] < math.log(_NEARNESS[witness])]
    if near:
      guess.scale, guess.offset, guess.named = _DEGREE / near[0], 0.0, True
      guess.why = [why for why in guess.why if "too much for" not in why]
      guess.why.append(f"whole numbers, by {witness} {per_degree:.3g} to a deg/s, so counts of {near[0]:.4g} to one")
      return [_question(guess, *near[:2])] if len(near) > 1 else []
  return []


def _question(guess: Guess, taken: float, other: float) -> str:
  scale = math.copysign(_DEGREE / other, guess.scale)
  return (
    f"'{guess.column}' has a gyro's counts, {taken:.4g} or {other:.4g} to a deg/s, which accelerometers do not tell: "
    f"which is it by its data sheet? for {other:.4g} set scale = {scale:.6g} on yaw_rate"
  )


def _counted(columns: Columns, name: str) -> bool:
  values, limit = columns.values(name), CHANNELS["yaw_rate"].limit
  return bool((values == np.round(values)).all() and columns.top(name) * _DEGREE > limit)


def _slope(recordings: Sequence[Recording], sizes: Mapping[str, float | str], witness: str) -> float | None:
  """rad/s per count, median over the logs. By forces it is the one across over the one along, as the scale of the speed
  is in both; a motor's has no scale yet."""
  slopes_of: dict[str, list[float]] = {"yaw_rate": [], "accel_x": [], "accel_y": []}
  for comparison in (c for recording in recordings for c in compare(recording, sizes)):
    slope, alike = comparison.slope()
    by_steering = "steering_command" in comparison.takes
    if comparison.channel in slopes_of and not by_steering and abs(alike) > UNIT_CORRELATION and abs(slope) > 0.0:
      slopes_of[comparison.channel].append(abs(slope))
  middle = {name: float(np.median(slopes)) for name, slopes in slopes_of.items() if slopes}
  if witness == "pose_yaw":
    return 1.0 / middle["yaw_rate"] if "yaw_rate" in middle else None
  return middle["accel_y"] / middle["accel_x"] if {"accel_x", "accel_y"} <= middle.keys() else None
