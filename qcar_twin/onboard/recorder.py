"""What was driven, as recordings of a data set: commands as they acted, sensors as they were read, roles proposed."""

import dataclasses
import math
from pathlib import Path

import numpy as np

from qcar_twin.onboard.car import Car
from qcar_twin.onboard.plants import OnboardPlant
from qcar_twin.recordings.dataset import DataSet, write_dataset
from qcar_twin.recordings.first_dataset.roles import share_out
from qcar_twin.recordings.manifest import FILE_NAME
from qcar_twin.recordings.recording import Recording, RecordingError

_TURNS = ("identify", "validate", "identify", "identify", "holdout")  # of drives too short to be cut
_LEAST = 0.5  # s of driving that make a recording


def recording_of(car: Car, name: str) -> Recording:
  """One drive as a recording.

  Raises:
    RecordingError: it was too short to be one.
  """
  rows = len(car.samples)
  if rows * car.period < _LEAST:
    raise RecordingError(f"the car was driven for {rows * car.period:.2f} s, too short to be a recording: drive longer")
  commands = np.array([*car.commands, car.commands[-1]])[:rows]
  columns = dict(zip(car.vehicle.commands, commands.T, strict=True))
  for channel in ("motor_speed", "accel_x", "accel_y", "yaw_rate"):
    columns[channel] = np.array([getattr(sample, channel) for sample in car.samples])
  poses = np.full((4, rows), math.nan)
  for fix in car.fixes:
    poses[:, round(fix.measured / car.period)] = fix.x, fix.y, fix.yaw, fix.score
  columns |= dict(zip(("pose_x", "pose_y", "pose_yaw", "pose_score"), poses, strict=True))
  time = np.round(car.period * np.arange(rows), 6)
  return Recording.from_columns(name, time, columns, file=f"{name}.csv")


def add_drive(folder: Path, recording: Recording, plant: OnboardPlant, script: str) -> tuple[Recording, ...]:
  """Add a drive to the data set in a folder, which is made where there is none; returns what was added.

  A drive of half a minute or more is cut by time into parts to identify, to validate and to hold out; shorter ones take
  turns. Roles are proposals: they stand in dataset.toml and can be changed there.

  Raises:
    RecordingError: the folder holds the data set of another car.
  """
  there: tuple[Recording, ...] = ()
  if (folder / FILE_NAME).is_file():
    dataset = DataSet.load(folder)
    there = dataset.recordings
    if dict(dataset.vehicle) != dict(plant.table):
      raise RecordingError(f"{folder}: holds recordings of another car; name another folder with --record")
  taken = {r.name.rpartition("_")[0] if r.name[-2:] in ("_1", "_2", "_3") else r.name for r in there}
  name, count = recording.name, 2
  while name in taken:
    name, count = f"{recording.name}_run{count}", count + 1
  added = _parts(recording.replace(name=name, file=f"{name}.csv"), len(there))
  text = f"Scripts driven on board: {plant.name}; the last one was {script}"
  write_dataset(folder, folder.resolve().name, plant.table, plant.std, (*there, *added), description=text)
  return added


def _parts(recording: Recording, place: int) -> tuple[Recording, ...]:
  made = []
  for part in share_out([recording], ""):
    begin = recording.start if part.begin is None else part.begin
    end = recording.end if part.end is None else part.end
    name = part.name or recording.name
    role = part.role if part.name else _TURNS[place % len(_TURNS)]
    piece = recording.window(begin, end)
    made.append(dataclasses.replace(piece, name=name, file=f"{name}.csv", role=role, session=recording.name))
  return tuple(made)
