"""Recordings written as a data set: a CSV for each, and dataset.toml."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from qcar_twin.atomic_io import staging, write_text
from qcar_twin.recordings.manifest import COMMAND_TIMINGS, FILE_NAME, read_manifest, require_file_name
from qcar_twin.recordings.recording import Recording, RecordingError, nearest


def write_recording(path: str | os.PathLike[str], recording: Recording) -> Path:
  """Write one recording as CSV in canonical channels, blank where there is no sample; every float survives exactly.
  What was derived is left out: reading derives it again."""
  time, columns = recording.replace(
    streams={name: stream for name, stream in recording.streams.items() if name not in recording.derived}
  ).columns()
  cells = [["" if value != value else repr(value) for value in column.tolist()] for column in (time, *columns.values())]
  lines = [",".join(("time", *columns)), *(",".join(row) for row in zip(*cells, strict=True))]
  return write_text(path, "\n".join(lines) + "\n")


def write_dataset(
  folder: str | os.PathLike[str],
  name: str,
  vehicle: Mapping[str, float | str],
  vehicle_std: Mapping[str, float],
  recordings: Iterable[Recording],
  description: str = "",
  command_timing: str = "after_measurement",
  licence: str = "",
  source: str = "",
) -> Path:
  """Write recordings and dataset.toml so that DataSet.load gives them back. Nothing in the folder changes unless all
  could be written beside it. Raises RecordingError for bad names, and for anything the loader would refuse in
  dataset.toml."""
  folder, recordings = Path(folder), tuple(recordings)
  text = _toml(name, vehicle, vehicle_std, recordings, description, command_timing, licence, source)
  created = not folder.exists()
  folder.mkdir(parents=True, exist_ok=True)
  try:
    _write_all(folder, recordings, text)
  except BaseException:
    if created:
      with contextlib.suppress(OSError):  # of a folder that holds something already
        folder.rmdir()
    raise
  return folder


def _write_all(folder: Path, recordings: tuple[Recording, ...], text: str) -> None:
  with staging(folder) as place:
    for recording in recordings:
      write_recording(place / f"{recording.name}.csv", recording)
    (place / FILE_NAME).write_text(text, encoding="utf-8")
    read_manifest(place)
    for recording in recordings:
      os.replace(place / f"{recording.name}.csv", folder / f"{recording.name}.csv")
    os.replace(place / FILE_NAME, folder / FILE_NAME)


def _toml(
  name: str,
  vehicle: Mapping[str, float | str],
  vehicle_std: Mapping[str, float],
  recordings: tuple[Recording, ...],
  description: str,
  command_timing: str,
  licence: str,
  source: str,
) -> str:
  if command_timing not in COMMAND_TIMINGS:
    raise RecordingError(f"unknown command_timing '{command_timing}'{nearest(command_timing, COMMAND_TIMINGS)}")
  for recording in recordings:
    require_file_name(recording.name)
  top = {
    "name": name,
    "command_timing": command_timing,
    "description": description,
    "licence": licence,
    "source": source,
  }
  tables = [_toml_table("", {key: value for key, value in top.items() if value}), _toml_table("[vehicle]", vehicle)]
  if vehicle_std:
    tables.append(_toml_table("[vehicle.std]", vehicle_std))
  for recording in recordings:
    about = {
      "file": f"{recording.name}.csv",
      "role": recording.role,
      "manoeuvre": recording.manoeuvre,
      "name": recording.name,
    }
    tables.append(
      _toml_table("[[recording]]", about | ({"session": recording.session} if recording.session is not None else {}))
    )
  return "\n".join(tables)


def _toml_table(head: str, content: Mapping[str, float | str]) -> str:
  lines = [f"{_toml_key(key)} = {_toml_value(value)}" for key, value in content.items()]
  return "\n".join(([head] if head else []) + lines) + "\n"


def _toml_key(key: str) -> str:
  return key if key.replace("_", "a").replace("-", "a").isalnum() and key.isascii() else json.dumps(key)


def _toml_value(value: float | str) -> str:
  if isinstance(value, str):
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
  return repr(float(value))
