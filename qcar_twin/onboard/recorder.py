"""What was driven, as recordings of a data set: commands as they acted, sensors as they were read, roles proposed."""

import dataclasses
import itertools
import math
import os
import re
from pathlib import Path

import numpy as np

from qcar_twin.atomic_io import staging, write_text
from qcar_twin.onboard.car import Car
from qcar_twin.onboard.plants import OnboardPlant
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.first_dataset.roles import share_out
from qcar_twin.recordings.manifest import FILE_NAME, Manifest, read_manifest
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


def free_name(folder: Path | None, script: str, plant: OnboardPlant) -> str:
  """What a script's next drive is called in the data set of a folder, which need not be there.

  Raises:
    RecordingError: the folder is a file, or holds drives of another car, or of one with other effects.
  """
  there = _manifest_for(folder, plant) if folder else None
  taken = {drive_of(entry.name) for entry in there.entries} if there else set()
  runs = itertools.chain([script], (f"{script}_run{k}" for k in itertools.count(2)))
  return next(name for name in runs if name not in taken)


def _manifest_for(folder: Path, plant: OnboardPlant) -> Manifest | None:
  """Of the data set that drives of a car are added to; None where there is none yet."""
  if folder.exists() and not folder.is_dir():
    raise RecordingError(f"{folder}: is a file; name a folder with --record")
  if not (folder / FILE_NAME).is_file():
    return None
  manifest = read_manifest(folder)
  if dict(manifest.vehicle) != dict(plant.table):
    raise RecordingError(f"{folder}: holds recordings of another car; name another folder with --record")
  if manifest.source not in ("", plant.name):
    said = f"{folder}: holds drives of another car ({manifest.source}), and this is {plant.name}"
    raise RecordingError(f"{said}; one data set is of one car: name another folder with --record")
  return manifest


def add_drive(folder: Path, recording: Recording, plant: OnboardPlant, script: str) -> tuple[Recording, ...]:
  """Add a drive to the data set in a folder, which is made where there is none; returns what was added.

  A drive of half a minute or more is cut by time into parts to identify, to validate and to hold out; shorter ones take
  turns. Roles are proposals: they stand in dataset.toml, and what a person changed there stays.

  Raises:
    RecordingError: the folder holds drives of another car, or of one with other effects.
  """
  text = f"Scripts driven on board; the first one was {script}"
  manifest = _manifest_for(folder, plant)
  if manifest is None:
    added = _parts(recording, 0)
    write_dataset(folder, folder.resolve().name, plant.table, plant.std, added, description=text, source=plant.name)
    return added
  added = _parts(recording, len(manifest.entries))
  with staging(folder) as place:
    write_dataset(place, manifest.name, plant.table, plant.std, added)
    tables = (place / FILE_NAME).read_text(encoding="utf-8").partition("[[recording]]")
    for piece in added:
      os.replace(place / f"{piece.name}.csv", folder / f"{piece.name}.csv")
  before = (folder / FILE_NAME).read_text(encoding="utf-8").rstrip("\n")
  write_text(folder / FILE_NAME, f"{before}\n\n{tables[1]}{tables[2]}")
  return added


def drive_of(name: str) -> str:
  """The drive that a recording, or a part of it, is of."""
  return re.sub(r"_part\d$", "", name)


def _parts(recording: Recording, place: int) -> tuple[Recording, ...]:
  made = []
  for part in share_out([recording], ""):
    begin = recording.start if part.begin is None else part.begin
    end = recording.end if part.end is None else part.end
    name = f"{recording.name}_part{len(made) + 1}" if part.name else recording.name
    role = part.role if part.name else _TURNS[place % len(_TURNS)]
    piece = recording.window(begin, end)
    made.append(dataclasses.replace(piece, name=name, file=f"{name}.csv", role=role))
  return tuple(made)
