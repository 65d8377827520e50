"""MATLAB files up to version 7: QUARC and Simulink logs as arrays, structures of vectors, or structures with time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from qcar_twin.recordings.formats.columnar import table_of_arrays
from qcar_twin.recordings.formats.table import Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError

READERS = {".mat": "read_mat"}
_CLOCKS = ("time", "Time", "t", "tout")


def read_mat(path: Path, label: str) -> Table:
  """Read a .mat file of version 4 to 7 as columns.

  * a vector `speed` is column `speed`;
  * a matrix `log` whose first signal increases (QUARC: first row time, a column per step) gives `log(1)`, `log(2)`, …,
    `time`;
  * a structure with time `log` gives `log.<label>` per signal (else the block's name), `log.<label>(2)` for vector
    signals;
  * a structure of vectors gives `log.<field>`.
  A name without its `log.` is understood too when it is unique. Structures with different clocks are merged.
  """
  variables = _load(path, label)
  clocked, vectors = [], {}
  for name, value in variables.items():
    for time, columns in _columns(name, value):
      if time is None:
        vectors |= columns
      else:
        clocked.append(Clocked(time, columns))
  if not clocked and not vectors:
    raise RecordingError(
      f"{label}: holds no numeric vectors (timeseries, table and Simulink Dataset objects cannot be read); "
      'in MATLAB save structures with time or plain vectors: save("log.mat", "time", "speed", "-v7")'
    )
  if not clocked:
    return table_of_arrays(vectors, label)
  return _with_short_names(merge(label, _joined(clocked, vectors)))


def _load(path: Path, label: str) -> dict[str, Any]:
  try:
    variables = scipy.io.loadmat(path, simplify_cells=True)
  except NotImplementedError as error:
    raise RecordingError(
      f'{label}: is a MATLAB 7.3 (HDF5) file; in MATLAB load it and save it again with save("log.mat", "-v7")'
    ) from error
  except MemoryError:
    raise
  except Exception as error:  # the reader raises many kinds for damaged files
    raise RecordingError(f"{label}: is not a readable .mat file ({error}); save it again with -v7") from error
  return {name: value for name, value in variables.items() if not name.startswith("__")}


def _columns(name: str, value: Any) -> Iterator[tuple[np.ndarray | None, dict[str, np.ndarray]]]:
  """The clock (or None) and the columns that a variable holds."""
  if isinstance(value, Mapping):
    yield from _structure(name, value)
  elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
    if value.ndim == 1 and value.size:
      yield None, {name: value.astype(float)}
    elif value.ndim == 2:
      yield _matrix(name, value.astype(float))


def _matrix(name: str, value: np.ndarray) -> tuple[np.ndarray | None, dict[str, np.ndarray]]:
  signals = value if value.shape[1] > value.shape[0] else value.T  # (signals, samples)
  columns = {f"{name}({number})": signal for number, signal in enumerate(signals, 1)}
  increasing = bool((np.diff(signals[0]) > 0.0).all())
  return (signals[0] if increasing else None), columns


def _structure(name: str, value: Mapping[str, Any]) -> Iterator[tuple[np.ndarray | None, dict[str, np.ndarray]]]:
  clock = next((np.asarray(value[key], dtype=float).ravel() for key in _CLOCKS if _is_vector(value.get(key))), None)
  columns = {f"{name}.{key}": np.asarray(field, dtype=float) for key, field in value.items() if _is_vector(field)}
  if clock is not None:
    columns = {key: column for key, column in columns.items() if column.size == clock.size}
    columns |= _signals(name, value.get("signals"), clock.size)
  if columns:
    yield clock, columns
  for key, field in value.items():
    if isinstance(field, Mapping) and key != "signals":
      yield from _structure(f"{name}.{key}", field)


def _is_vector(value: Any) -> bool:
  return isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "fiub" and value.size > 0


def _signals(name: str, signals: Any, samples: int) -> dict[str, np.ndarray]:
  """Columns of the `signals` of a structure with time: one structure or an array of them, each with `values`."""
  listed = [signals] if isinstance(signals, Mapping) else list(signals) if signals is not None else []
  columns = {}
  for number, signal in enumerate(listed, 1):
    values = np.asarray(signal.get("values", ()), dtype=float)
    if samples not in values.shape:
      continue
    values = np.moveaxis(values, values.shape.index(samples), 0).reshape(samples, -1)
    label = _label(signal) or f"signals({number})"
    for part in range(values.shape[1]):
      columns[f"{name}.{label}" if values.shape[1] == 1 else f"{name}.{label}({part + 1})"] = values[:, part]
  return columns


def _label(signal: Mapping[str, Any]) -> str:
  label = signal.get("label")
  if isinstance(label, str) and label.strip():
    return label.strip().strip("<>")
  block = signal.get("blockName")
  return block.rsplit("/", 1)[-1].strip() if isinstance(block, str) else ""


def _joined(clocked: list[Clocked], vectors: Mapping[str, np.ndarray]) -> list[Clocked]:
  """Put plain vectors beside the clock of their length; groups that share a clock stay groups."""
  first = clocked[0]
  beside = {name: vector for name, vector in vectors.items() if vector.size == first.time.size and name != "time"}
  return [Clocked(first.time, {**first.columns, **beside}), *clocked[1:]]


def _with_short_names(table: Table) -> Table:
  short: dict[str, list[str]] = {}
  for name in table.columns:
    short.setdefault(name.rsplit(".", 1)[-1], []).append(name)
  aliases = {brief: names[0] for brief, names in short.items() if len(names) == 1 and brief not in table.columns}
  columns = dict(table.columns) | {brief: table.columns[name] for brief, name in aliases.items()}
  return Table(table.label, columns, table.not_a_number, blanks=False)
