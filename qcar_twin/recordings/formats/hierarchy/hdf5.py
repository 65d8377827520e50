"""HDF5: vectors in groups. A sensor's group has a clock of its own; a group a trial makes several recordings."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from qcar_twin.extras import extra
from qcar_twin.recordings.formats.apart import ReaderEnded, read_apart
from qcar_twin.recordings.formats.columnar import table_of_arrays
from qcar_twin.recordings.formats.folder import stamps_of
from qcar_twin.recordings.formats.table import Clocked, NoSamples, SeveralRecordings, Table, merge
from qcar_twin.recordings.recording import RecordingError

_CONTENT = "qcar_twin.recordings.formats.hierarchy.hdf5_content"
_ALIKE = 0.5  # of the columns of the trial with more, that another one has, too
Inside = tuple[str, ...]  # where a vector is: its groups, and its name with its unit
Of = tuple[Inside, int]  # the groups and the length of vectors of one clock
Vectors = Mapping[Inside, np.ndarray]


def read_hdf5(path: Path, label: str) -> Table:
  """Read a file of vectors, `imu.ax [m/s^2]` of a dataset `ax` in a group `imu`, its unit by the attribute `unit`.

  Each vector goes by the clock of its length in its group, else in the next one above. Without any clock all of one
  length are one table.

  Raises:
    SeveralRecordings: groups that hold the same are trials, a recording each.
    RecordingError: not readable, or without a vector.
    MissingExtra: h5py is not installed.
  """
  with extra("Reading HDF5"):
    if find_spec("h5py") is None:
      raise ModuleNotFoundError("No module named 'h5py'", name="h5py")
  try:
    read = {name: column for _, columns in read_apart(_CONTENT, path, label) for name, column in columns.items()}
  except ReaderEnded as error:
    raise RecordingError(f"{label}: is not a readable HDF5 file ({error}); write it again") from error
  vectors = {_parts(name): column for name, column in read.items()}
  if not vectors:
    raise NoSamples(f"{label}: holds no vector of numbers; write a dataset per channel, and one of their times")
  trials = trials_of(list(vectors))
  if not trials:
    return _table(vectors, label)
  inside = lambda name, prefix: name[: len(prefix)] == prefix
  beside = [_called(name) for name in vectors if not any(inside(name, prefix) for prefix in trials.values())]
  notes = (f"{label}: {', '.join(beside)}: belongs to no recording; left out",) if beside else ()
  tables = {}
  for trial, prefix in trials.items():
    own = {name[len(prefix) :]: column for name, column in vectors.items() if inside(name, prefix)}
    table = _table(own, f"{label}/{trial}")
    tables[trial] = dataclasses.replace(table, notes=(*notes, *table.notes))
  raise SeveralRecordings(label, tables)


def _parts(name: str) -> Inside:
  """A path as its parts; the unit behind it may have a slash of its own."""
  path, bracket, unit = name.rpartition(" [")
  if not unit.endswith("]") or not path:
    return tuple(name.split("/"))
  *groups, last = path.split("/")
  return (*groups, f"{last}{bracket}{unit}")


def _called(name: Inside) -> str:
  return ".".join(name)


def trials_of(names: Sequence[Inside]) -> dict[str, Inside]:
  """By trial the groups that it is in; none where the groups are not trials.

  Groups beside each other are trials where all hold much the same, and are called alike but for numbers or have groups
  of their own: sensors differ, and so do wheels from commands.
  """
  before: Inside = ()
  while True:
    depth, inside = len(before), dict[str, set[Inside]]()
    for name in names:
      if name[:depth] == before and len(name) > depth + 1:
        inside.setdefault(name[depth], set()).add(name[depth + 1 :])
    if len(inside) != 1:
      break
    before = (*before, next(iter(inside)))
  kinds = {re.sub(r"\d+", "", name) for name in inside}
  nested = all(any(len(rest) > 1 for rest in held) for held in inside.values())
  most = max(inside.values(), key=len, default=set())
  alike = all(len(held & most) >= _ALIKE * len(most) for held in inside.values())
  trials = len(inside) > 1 and alike and (nested or len(kinds) == 1)
  return {name: (*before, name) for name in inside} if trials else {}


def _table(vectors: Vectors, label: str) -> Table:
  """One recording of vectors by their paths."""
  same: dict[Of, dict[str, np.ndarray]] = {}
  for name, column in vectors.items():
    same.setdefault((name[:-1], column.size), {})[name[-1]] = column
  clocks = {key: clock for key, own in same.items() if (clock := stamps_of(Table(label, own, {}))) is not None}
  if not clocks:
    return table_of_arrays({_called(name): column for name, column in vectors.items()}, label)
  by_clock: dict[Of, dict[str, np.ndarray]] = {key: {} for key in clocks}
  lost = []
  for (groups, size), own in same.items():
    above = [(groups[:count], size) for count in range(len(groups), -1, -1)]
    key = next((key for key in above if key in clocks), None)
    named = {_called((*groups, name)): column for name, column in own.items()}
    if key is not None:
      gone = _called((*key[0], clocks[key][0]))
      by_clock[key] |= {name: column for name, column in named.items() if name != gone}
    elif size > 1:
      lost.append(f"{label}: {', '.join(named)}: no clock of {size} values in its group; left out")
  table = merge(label, [_in_order(clocks[key][1], columns) for key, columns in by_clock.items()])
  return dataclasses.replace(table, blanks=False, notes=(*lost, *table.notes))


def _in_order(time: np.ndarray, columns: Mapping[str, np.ndarray]) -> Clocked:
  order = np.argsort(time, kind="stable")
  return Clocked(time[order], {name: column[order] for name, column in columns.items()})
