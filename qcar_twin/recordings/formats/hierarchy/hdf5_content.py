"""What an HDF5 file holds, by h5py. Runs in a process of its own (`apart`): damaged files bring the library down.

Only what lies in the file itself is read: no links to other files, no datasets whose values other files hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from qcar_twin.extras import extra
from qcar_twin.recordings.formats.apart import Group
from qcar_twin.recordings.recording import RecordingError

with extra("Reading HDF5"):
  import h5py

_DEEPEST = 12  # groups in groups
_WIDEST = 16  # columns of an array that holds a row for each sample
_UNITS = ("unit", "units")


def groups(path: Path, label: str) -> Iterator[Group]:
  """One group without a clock: every vector by its path, `trial_1/imu/ax [m/s^2]`, its unit by the attribute `unit`.

  An array of (samples, k) gives `.x`, `.y` and `.z` of three, else `[0]`, `[1]` …; a compound type's fields are vectors
  of their own. Raises RecordingError: no readable HDF5.
  """
  try:
    file = h5py.File(str(path), "r")
  except OSError as error:
    raise RecordingError(f"{label}: is not a readable HDF5 file ({error}); write it again") from error
  with file:
    yield None, dict(_vectors(file, "", _DEEPEST))


def _vectors(group: h5py.Group, before: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
  """Names and values, (samples,), of what a group and those within it hold."""
  for name in group:
    if depth == 0 or not isinstance(group.get(name, getlink=True), h5py.HardLink):
      continue
    value = group[name]
    if isinstance(value, h5py.Group):
      yield from _vectors(value, f"{before}{name}/", depth - 1)
    elif isinstance(value, h5py.Dataset) and not value.is_virtual and not value.external:
      yield from _columns(f"{before}{name}", value)


def _columns(name: str, values: h5py.Dataset) -> Iterator[tuple[str, np.ndarray]]:
  if values.dtype.names and len(values.shape) == 1:
    rows = values[()]
    for field in values.dtype.names:
      if rows[field].ndim == 1 and rows[field].dtype.kind in "fiub":
        yield f"{name}/{field}", rows[field].astype(float)
    return
  shape = tuple(size for size in values.shape if size != 1)
  if values.dtype.kind not in "fiub" or not 1 <= len(shape) <= 2:
    return
  unit = _unit(values.attrs)
  if len(shape) == 1:
    yield f"{name}{unit}", np.ravel(values[()]).astype(float)
  elif 1 < shape[1] <= _WIDEST < shape[0]:
    marks = [f".{axis}" for axis in "xyz"] if shape[1] == 3 else [f"[{k}]" for k in range(shape[1])]
    whole = np.reshape(values[()], shape).astype(float)
    yield from ((f"{name}{mark}{unit}", column) for mark, column in zip(marks, whole.T, strict=True))


def _unit(attributes: Mapping[str, object]) -> str:
  """The attribute that says a unit, as it stands behind a column's name."""
  said = next((attributes[key] for key in attributes if key.lower() in _UNITS), "")
  said = said.decode("utf-8", "replace") if isinstance(said, bytes) else said
  return f" [{said.strip()}]" if isinstance(said, str) and said.strip() else ""
