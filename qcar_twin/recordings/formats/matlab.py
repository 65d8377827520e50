"""MATLAB files: QUARC and Simulink logs as arrays, structures of vectors, structures with time, or timeseries."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from qcar_twin.extras import MissingExtra, extra
from qcar_twin.recordings.formats.apart import OBJECTS, Group, ReaderEnded, read_apart
from qcar_twin.recordings.formats.columnar import table_of_arrays
from qcar_twin.recordings.formats.table import Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError

READERS = {".mat": "read_mat"}
_CONTENT = "qcar_twin.recordings.formats.matlab_apart.content"  # SciPy's reader comes down on some files
_OBJECT_CONTENT = "qcar_twin.recordings.formats.matlab_apart.objects"
_AS_STRUCTURE = (
  'in MATLAB save each as a structure with time: s = struct("time", speed.Time, "speed", squeeze(speed.Data)); '
  'save("log.mat", "s", "-v7")'
)


def read_mat(path: Path, label: str) -> Table:
  """Read a .mat file as columns; objects and version 7.3 with the extra `matlab`.

  * a vector `speed` is column `speed`;
  * a matrix `log` whose first signal increases (QUARC: first row time, a column per step) gives `log(1)`, `log(2)`, …,
    `time`;
  * a structure with time `log` gives `log.<label>` per signal (else the block's name), `log.<label>(2)` for vector
    signals;
  * a structure of vectors gives `log.<field>`;
  * a timeseries `speed` gives `speed`, one in a Dataset or a structure `log` gives `log.<name>`.
  A name without its `log.` is understood too when it is unique. Structures with different clocks are merged.
  """
  groups = _new_version(path, label) if is_7_3(path) else _old_version(path, label)
  clocked, vectors = [], {}
  for time, columns in groups:
    if time is None:
      vectors |= columns
    else:
      clocked.append(Clocked(time, columns))
  if not clocked and not vectors:
    raise RecordingError(
      f"{label}: holds neither numeric vectors nor structures with time nor timeseries; "
      'in MATLAB save structures with time or plain vectors: save("log.mat", "time", "speed", "-v7")'
    )
  if not clocked:
    return table_of_arrays(vectors, label)
  return _with_short_names(merge(label, _joined(clocked, vectors)))


def is_7_3(path: Path) -> bool:
  """Whether a .mat file is of version 7.3, which is HDF5."""
  with path.open("rb") as file:
    return file.read(128)[124:] in (b"\x00\x02IM", b"\x02\x00MI")  # version 0x0200, in either order of bytes


def _new_version(path: Path, label: str) -> list[Group]:
  cure = 'in MATLAB load it and save it again with save("log.mat", "-v7")'
  try:
    return _objects(path, label)
  except MissingExtra as error:
    raise RecordingError(f"{label}: is a MATLAB 7.3 (HDF5) file. {error}; or {cure}") from error
  except (RecordingError, ReaderEnded) as error:
    raise RecordingError(f"{label}: is a MATLAB 7.3 (HDF5) file that cannot be read ({error}); {cure}") from error


def _old_version(path: Path, label: str) -> list[Group]:
  try:
    groups = read_apart(_CONTENT, path, label)
  except ReaderEnded as error:
    raise RecordingError(f"{label}: is not a readable .mat file ({error}); save it again with -v7") from error
  plain = [(time, columns) for time, columns in groups if OBJECTS not in columns]
  if len(plain) == len(groups):
    return plain
  try:
    return [*plain, *_objects(path, label)]
  except MissingExtra as error:
    if plain:  # what can be read is; a channel that is not there is asked for by its name
      return plain
    raise RecordingError(f"{label}: holds MATLAB objects alone. {error}; or {_AS_STRUCTURE}") from error
  except ReaderEnded as error:
    raise RecordingError(f"{label}: its objects cannot be read ({error}); {_AS_STRUCTURE}") from error


def _objects(path: Path, label: str) -> list[Group]:
  with extra("Reading MATLAB objects"):
    if find_spec("matio") is None:
      raise ModuleNotFoundError("No module named 'matio'", name="matio")
  return read_apart(_OBJECT_CONTENT, path, label)


def _joined(clocked: list[Clocked], vectors: Mapping[str, np.ndarray]) -> list[Clocked]:
  """Put plain vectors with the clock of their length; groups that share a clock stay groups."""
  first = clocked[0]
  of_length = {name: vector for name, vector in vectors.items() if vector.size == first.time.size and name != "time"}
  return [Clocked(first.time, {**first.columns, **of_length}), *clocked[1:]]


def _with_short_names(table: Table) -> Table:
  short: dict[str, list[str]] = {}
  for name in table.columns:
    short.setdefault(name.rsplit(".", 1)[-1], []).append(name)
  aliases = {brief: names[0] for brief, names in short.items() if len(names) == 1 and brief not in table.columns}
  columns = dict(table.columns) | {brief: table.columns[name] for brief, name in aliases.items()}
  return dataclasses.replace(table, columns=columns, blanks=False)
