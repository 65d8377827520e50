"""Parquet and NPZ, files that already are columns, and what any table of pyarrow's comes to."""

from __future__ import annotations

import dataclasses
import os
import re
import zipfile
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet

from qcar_twin.recordings.formats.dates import seconds_of
from qcar_twin.recordings.formats.generalised import axes_of
from qcar_twin.recordings.formats.table import NO_ROWS, Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import words_of
from qcar_twin.untrusted import memory_for

pyarrow.set_memory_pool(pyarrow.system_memory_pool())  # where pyarrow was imported before: see formats
pyarrow.scalar(0)  # imports pandas, if it is there, now and not under the bound that is for a file's contents

CLOCKS = {"t", "time", "times", "stamp", "stamps", "timestamp", "timestamps", "clock"}
_BYTES = np.dtype(float).itemsize  # that a cell becomes, whatever a file holds it as
_WIDEST = 16  # columns of an array that holds a row for each sample
# "Speed"|"MPH"|0.0|150.0|10, with some of its quotes read away
_RANGED = re.compile(r'^"?(?P<name>[^"|]+)"?\|"?(?P<unit>[^"|]*)"?\|[-+.\d]*\|[-+.\d]*\|\d+$')
UNNAMED = "unnamed"  # and its number: what a column without a name is called

READERS = {".parquet": "read_parquet", ".npz": "read_npz"}


def read_parquet(path: Path, label: str) -> Table:
  """A Parquet file with flat numeric columns; null means no sample."""
  try:
    with opened(path) as stream, pyarrow.parquet.ParquetFile(stream, pre_buffer=False) as file:
      stated = _BYTES * file.metadata.num_rows * file.metadata.num_columns
      if stated > memory_for(path.stat().st_size):  # no need to unpack a gigabyte to see that there are more
        raise MemoryError(f"{label}: holds {file.metadata.num_rows} rows")
      table = file.read(use_threads=False)
  except (pyarrow.ArrowException, OSError) as error:
    if isinstance(error, MemoryError) or getattr(error, "errno", None):
      raise
    raise RecordingError(f"{label}: is not a readable Parquet file ({error}); write it again") from error
  return table_of_arrow(table, label)


def read_npz(path: Path, label: str) -> Table:
  """One array per column, all of the length of `time`; NaN means no sample. Pickled objects are refused."""
  try:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
      arrays = {name: _loaded(archive, name, label) for name in archive.files}
  except (zipfile.BadZipFile, EOFError, ValueError) as error:
    if isinstance(error, RecordingError):
      raise
    raise RecordingError(f"{label}: is not a readable NPZ file ({error}); write it with numpy.savez") from error
  return table_of_arrays(arrays, label)


def table_of_arrays(arrays: dict[str, np.ndarray], label: str) -> Table:
  """Columns from arrays that need not all be columns: the vectors as long as `time`, else of the commonest length.

  Where the vectors of every length have a clock of their own, `t_imu` and `t_encoder` say, each keeps its times.
  """
  vectors = {name: np.squeeze(array) for name, array in _vectors(arrays).items() if array.dtype.kind in "fiub"}
  vectors = {name: vector.astype(float) for name, vector in vectors.items() if vector.ndim == 1 and vector.size}
  if not vectors:
    raise RecordingError(
      f"{label}: holds no numeric vectors; save one array per channel, such as time and motor_voltage"
    )
  lengths = [vector.size for vector in vectors.values()]
  length = vectors["time"].size if "time" in vectors else max(set(lengths), key=lengths.count)
  odd = [f"{name} has {vector.size}" for name, vector in vectors.items() if vector.size not in (length, 1)]
  if odd and (groups := _clocked(vectors)):
    return dataclasses.replace(merge(label, groups), blanks=False)
  if odd:
    raise RecordingError(
      f"{label}: arrays must have one length ({length} samples, as time): {', '.join(odd)}; "
      "save a clock with the arrays of each length, t_imu and t_encoder say, or pad channels of another rate with NaN"
    )
  columns = {name: vector for name, vector in vectors.items() if vector.size == length}
  return Table(
    label, columns, {name: np.flatnonzero(np.isnan(vector)) for name, vector in columns.items()}, blanks=False
  )


def _vectors(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
  """The arrays, those with a row for each sample as their columns: `state[0]`, and `gyro.x` to `gyro.z` of three, or
  `pose.x`, `pose.y` and `pose.yaw` of a pose on the floor."""
  out = {}
  for name, array in arrays.items():
    if array.ndim != 2 or not 1 < array.shape[1] <= _WIDEST < array.shape[0]:
      out[name] = array
      continue
    axes = axes_of(name, array.T.astype(float)) if array.shape[1] == 3 and array.dtype.kind in "fiub" else None
    marks = [f".{axis}" for axis in axes] if axes else [f"[{k}]" for k in range(array.shape[1])]
    out |= {f"{name}{mark}": column for mark, column in zip(marks, array.T, strict=True)}
  return out


def _clocked(vectors: dict[str, np.ndarray]) -> list[Clocked]:
  """Vectors of one length each with the one among them that is a clock by its name and rises; none where a length has
  none. Of several clocks of one length a vector goes by the one that shares a word with it, as `enc` of `t_enc` and
  `v_enc`, else by the last that was saved before it."""
  groups = []
  for length in sorted({vector.size for vector in vectors.values()} - {1}):
    same = {name: vector for name, vector in vectors.items() if vector.size == length}
    clocks = [name for name, vector in same.items() if set(words_of(name)) & CLOCKS and (np.diff(vector) > 0.0).all()]
    if not clocks:
      return []
    own: dict[str, dict[str, np.ndarray]] = {name: {} for name in clocks}
    before = clocks[0]
    for name, vector in same.items():
      if name in own:
        before = name
        continue
      shared = [clock for clock in clocks if set(words_of(clock)) & set(words_of(name)) - CLOCKS]
      own[shared[0] if len(shared) == 1 else before][name] = vector
    groups += [Clocked(same[clock], columns) for clock, columns in own.items()]
  return groups


def _loaded(archive: np.lib.npyio.NpzFile, name: str, label: str) -> np.ndarray:
  try:
    return archive[name]
  except ValueError as error:
    if "allow_pickle" not in str(error):
      raise
    raise RecordingError(
      f"{label}: array '{name}' holds Python objects, which are never unpickled; save plain float arrays"
    ) from error


def opened(path: Path) -> pyarrow.NativeFile:
  """The file, by the bytes of its name: pyarrow takes text for UTF-8, which names are not in every locale."""
  return pyarrow.OSFile(os.fsencode(path))


def table_of_arrow(table: pyarrow.Table, label: str) -> Table:
  names = [_name(name, number) for number, name in enumerate(table.column_names, 1)]
  table = table.slice(0, _filled_rows(table))
  columns, not_a_number = {}, {}
  ambiguous = set()
  for index, name in enumerate(names):
    values, nans = _column(table.column(index))
    if name in columns and not _same(values, columns[name]):
      ambiguous.add(name)
    columns[name], not_a_number[name] = values, nans
  return Table(label, columns, not_a_number, frozenset(ambiguous))


def _same(one: np.ndarray, other: np.ndarray) -> bool:
  """Whether two columns hold the same, blank cells too."""
  return np.array_equal(one, other, equal_nan=one.dtype != object and other.dtype != object)


def _name(written: str, number: int) -> str:
  """A column's name; the mark of a comment that the header was written as is none, and one without a name gets one.
  Name, unit, range and rate in one, as RaceCapture writes them, are a name with its unit."""
  name = written.strip()
  name = name.lstrip("# \t") if number == 1 and name.startswith("#") else name
  if (parts := _RANGED.match(name)) is not None:
    name = f"{parts['name']} [{parts['unit']}]" if parts["unit"] else parts["name"]
  return name or f"{UNNAMED}_{number}"


def _filled_rows(table: pyarrow.Table) -> int:
  """Rows up to the last that is not blank in every cell: spreadsheets often leave blank rows at the end."""
  rows = table.num_rows
  while rows and all(not column[rows - 1].is_valid for column in table.columns):
    rows -= 1
  return rows


def _column(column: pyarrow.ChunkedArray) -> tuple[np.ndarray, np.ndarray]:
  """Float values with NaN where blank, and the rows that hold a NaN of their own; text stays text."""
  kind = column.type
  if pyarrow.types.is_timestamp(kind):
    seconds = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
    return _column(column.cast(pyarrow.int64()))[0] * seconds, NO_ROWS
  if not (
    pyarrow.types.is_floating(kind)
    or pyarrow.types.is_integer(kind)
    or pyarrow.types.is_boolean(kind)
    or pyarrow.types.is_null(kind)
  ):
    texts = column.to_pylist()
    seconds = seconds_of(texts)
    return (np.array(texts, dtype=object), NO_ROWS) if seconds is None else (seconds, NO_ROWS)
  values = column.cast(pyarrow.float64(), safe=False).to_numpy()
  nan = np.isnan(values)
  if column.null_count:
    nan = nan & ~column.is_null().to_numpy()
  return values, np.flatnonzero(nan)
