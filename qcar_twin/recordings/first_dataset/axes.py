"""Logs that count to the right: a car whose every turning channel is mirrored looks like a mirrored car.

Which way an IMU's z axis points tells, and the names of engines whose frames are left-handed, or have z down: Unreal's
(CARLA's documentation, "Coordinates and transformations"), Unity's (manual, "Rotation and orientation in Unity"),
AirSim's (documentation, "APIs: coordinate system": north, east, down) and PX4's (user guide, "Using vision or motion
capture systems", reference frames: forward, right, down).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.channels import GRAVITY
from qcar_twin.recordings.first_dataset.columns import Columns, Guess
from qcar_twin.recordings.first_dataset.heading import contrary
from qcar_twin.recordings.first_dataset.plane import upright
from qcar_twin.recordings.first_dataset.scales.sides import side_of
from qcar_twin.recordings.recording import Recording
from qcar_twin.recordings.unit_names import unit_of, words_of

_VERTICAL = {"az", "accz", "accelz", "acc", "accel", "acceleration", "accelerometer"}
_NEAR = 0.2  # of gravity, to which an axis that is upright reads it: 0.2 is a mount tilted by 37 deg
# what columns are called where an engine's frames are written as they are: each set of words in one name
_ENGINES = (
  ("CARLA", ({"location"}, {"rotation", "yaw"})),
  ("CARLA", ({"frame"}, {"throttle"}, {"steer"}, {"brake"}, {"yaw"})),
  ("Unity", ({"euler", "angles"},)),
  ("AirSim", ({"pos", "x"}, {"q", "w"}, {"handbrake"})),
  ("PX4", ({"vehicle", "local", "position"},)),
)
_LEFT_HANDED = {"CARLA", "Unity"}  # whose IMU tells nothing: its axes are mirrored as well,
_COMPASS = {"heading", "course", "bearing", "azimuth", "compass", "hdg", "cog"}
_SIDED = ("steering_command", "accel_y", "yaw_rate", "pose_y", "pose_yaw")


def turning_right(columns: Columns, guesses: Mapping[str, Guess], lies: bool = False) -> list[str]:
  """Questions about logs that may count to the right, which nothing else in them tells: of an engine whose frames do,
  by its names; a compass's heading alone, beside neither a gyro nor a place.

  Args:
    lies: whether gravity told how the IMU lies, and so which way a log of right-handed axes counts.
  """
  engine = _engine(columns)
  engine = None if lies and engine not in _LEFT_HANDED else engine
  sided = [name for name in _SIDED if name in guesses]
  if (engine or upright(columns, guesses)) and side_of(columns, guesses):
    return []
  if engine is not None and sided:
    return [
      f"the columns are called as {engine}'s, which counts to the right: is left positive in this log? if right is, "
      f"multiply scale and offset of {', '.join(sided)} by -1"
    ]
  if sided and (up := upright(columns, guesses)):
    return [
      f"'{up}' points up, as in motion capture, which counts to the left, and in Unity, which counts to the right: is "
      f"left positive in this log? if right is, multiply scale and offset of {', '.join(sided)} by -1"
    ]
  heading = guesses.get("pose_yaw")
  if heading is None or guesses.keys() & {"yaw_rate", "pose_x", "accel_y"}:
    return []
  values = heading.scale * columns.values(heading.column)
  if not set(words_of(heading.column)) & _COMPASS or values.min() < 0.0 or values.max() < np.pi:
    return []
  return [
    f"'{heading.column}' may count as a compass does, clockwise: is left positive in this log? if right is, multiply "
    f"scale and offset of {', '.join(name for name in ('steering_command', 'pose_yaw') if name in guesses)} by -1"
  ]


def settle_sides(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """Mirror a log that may count to the right, of an engine by its names or with a place whose y points up, where the
  wheels outside of its turns say that it does."""
  if not (_engine(columns) or upright(columns, guesses)) or side_of(columns, guesses) >= 0:
    return
  for guess in (guesses[name] for name in _SIDED if name in guesses):
    guess.reverse("counted to the right: the wheels outside of turns go faster")


def _engine(columns: Columns) -> str | None:
  """The engine as whose columns these are called."""
  names = [set(words_of(name)) for name in columns.names]
  return next((one for one, signs in _ENGINES if all(any(sign <= name for name in names) for sign in signs)), None)


def pointing_down(columns: Columns, guesses: Mapping[str, Guess], recordings: Sequence[Recording]) -> str | None:
  """A question, where an accelerometer reads minus gravity along z: its axes are those of aircraft, x forward, y right,
  z down, and turning is positive to the right.

  Nothing else in a log tells, since all that turns may be mirrored alike. An accelerometer whose z points up reads plus
  gravity at rest, 9.8 m/s^2. Where heading and gyro are contrary, it is the IMU alone that lies upside down, and the
  steering, whose sign is taken from the gyro.

  Args:
    recordings: the logs as the guesses read them.
  """
  along = guesses.get("accel_x") or guesses.get("accel_y")
  alone = contrary(recordings)
  sided = [name for name in _SIDED if name in guesses and not (alone and name.startswith("pose"))]
  if along is None or not {"yaw_rate", "accel_y"} & set(sided):
    return None
  for name in columns.names:
    words = words_of(name)
    if not (set(words) & _VERTICAL and ("z" in words or words[0].endswith("z"))):
      continue
    unit = unit_of(name)
    scale = unit[2] if unit is not None and unit[1] == "m/s^2" else along.scale
    usual = abs(scale) * float(np.median(columns.values(name)))
    if abs(usual + GRAVITY) < _NEAR * GRAVITY:
      which = "in what the IMU says" if alone else "in this log"
      return (
        f"'{name}' is {usual:.3g} m/s^2, as where z points down: is left positive {which}? if right is, multiply "
        f"scale and offset of {', '.join(sided)} by -1"
      )
  return None
