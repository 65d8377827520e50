"""MATLAB files up to version 7: QUARC and Simulink logs as arrays, structures of vectors, or structures with time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from qcar_twin.recordings.formats.apart import ReaderEnded, read_apart
from qcar_twin.recordings.formats.columnar import table_of_arrays
from qcar_twin.recordings.formats.table import Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError

READERS = {".mat": "read_mat"}
_CONTENT = "qcar_twin.recordings.formats.matlab_content"  # read apart: SciPy's reader comes down on some files


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
  try:
    groups = read_apart(_CONTENT, path, label)
  except ReaderEnded as error:
    raise RecordingError(f"{label}: is not a readable .mat file ({error}); save it again with -v7") from error
  clocked, vectors = [], {}
  for time, columns in groups:
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
  return Table(table.label, columns, table.not_a_number, blanks=False)
