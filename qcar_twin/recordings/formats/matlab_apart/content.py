"""What a MATLAB file holds, read by SciPy; runs in a process of its own (`apart`), since damage can bring that down."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from scipy.io.matlab import MatlabOpaque, MatReadWarning

from qcar_twin.recordings.formats.apart import OBJECTS, Group
from qcar_twin.recordings.recording import RecordingError

_CLOCKS = ("time", "Time", "t", "tout")


def groups(path: Path, label: str) -> Iterator[Group]:
  """The clock (or None) and the numeric columns of every variable of a .mat file of version 4 to 7.

  Raises RecordingError: version 7.3, not readable.
  """
  variables = _load(path, label)
  for name, value in variables.items():
    if name != "None":
      yield from columns_of(name, value)
  if any(_holds_object(value) for value in variables.values()):
    yield None, {OBJECTS: np.zeros(1)}


def _holds_object(value: Any) -> bool:
  if isinstance(value, Mapping):
    return any(_holds_object(field) for field in value.values())
  if isinstance(value, MatlabOpaque):
    return True
  return isinstance(value, np.ndarray) and value.dtype == object and any(_holds_object(item) for item in value.ravel())


def _load(path: Path, label: str) -> dict[str, Any]:
  try:
    with warnings.catch_warnings():
      warnings.simplefilter("ignore", MatReadWarning)  # objects have no name for it, so that two are one
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


def columns_of(name: str, value: Any) -> Iterator[Group]:
  """The clock (or None) and the columns that a variable holds."""
  if isinstance(value, Mapping):
    yield from _structure(name, value)
  elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
    if value.ndim == 1 and value.size:
      yield None, {name: value.astype(float)}
    elif value.ndim == 2:
      yield _matrix(name, value.astype(float))


def _matrix(name: str, value: np.ndarray) -> Group:
  signals = value if value.shape[1] > value.shape[0] else value.T  # (signals, samples)
  columns = {f"{name}({number})": signal for number, signal in enumerate(signals, 1)}
  increasing = bool((np.diff(signals[0]) > 0.0).all())
  return (signals[0] if increasing else None), columns


def _structure(name: str, value: Mapping[str, Any]) -> Iterator[Group]:
  if drawn := _drawn(value):
    yield from drawn
    return
  clock = next((np.asarray(value[key], dtype=float).ravel() for key in _CLOCKS if _is_vector(value.get(key))), None)
  columns = {f"{name}.{key}": np.asarray(field, dtype=float) for key, field in value.items() if _is_vector(field)}
  if clock is not None:
    columns = {key: column for key, column in columns.items() if column.size == clock.size}
    columns |= _signals(name, value.get("signals"), clock.size)
    for key, field in value.items():  # three axes of a gyro, say
      if isinstance(field, np.ndarray) and field.ndim == 2 and field.dtype.kind in "fiub" and clock.size in field.shape:
        columns |= signal_columns(f"{name}.{key}", field.astype(float), clock.size)
  if columns:
    yield clock, columns
  for key, field in value.items():
    if isinstance(field, Mapping) and key != "signals":
      yield from _structure(f"{name}.{key}", field)


def _drawn(value: Mapping[str, Any]) -> list[Group]:
  """Signals of dSPACE's ControlDesk: axes `X`, of which a signal in `Y` names one by `XIndex`, each with `Name` and
  `Data`. A signal is called by the end of its path in the model, with its unit, and a clock by that of an axis."""
  axes, signals = (_listed(value.get(key)) for key in ("X", "Y"))
  if not axes or not signals or not all(_is_vector(each.get("Data")) for each in (*axes, *signals)):
    return []
  groups: list[Group] = []
  for number, axis in enumerate(axes, 1):
    clock = np.asarray(axis["Data"], dtype=float)
    own = [each for each in signals if len(axes) == 1 or each.get("XIndex", 1) == number]
    columns = {_path_end(each): np.asarray(each["Data"], dtype=float) for each in own}
    groups.append((clock, {name: data for name, data in columns.items() if data.size == clock.size}))
  return groups


def _path_end(signal: Mapping[str, Any]) -> str:
  """The last part of a signal's path, `"Model Root/IMU/ay"`, with its unit in brackets."""
  unit = signal.get("Unit")
  name = str(signal.get("Name", "")).strip('"').rstrip("/").rsplit("/", 1)[-1]
  return f"{name} [{unit}]" if isinstance(unit, str) and unit.strip() else name


def _listed(value: Any) -> list[Mapping[str, Any]]:
  """One structure or an array of them; none of anything else."""
  listed = [value] if isinstance(value, Mapping) else list(value) if isinstance(value, np.ndarray | list) else []
  return listed if all(isinstance(each, Mapping) for each in listed) else []


def _is_vector(value: Any) -> bool:
  return isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "fiub" and value.size > 0


def _signals(name: str, signals: Any, samples: int) -> dict[str, np.ndarray]:
  """Columns of the `signals` of a structure with time: one structure or an array of them, each with `values`."""
  columns = {}
  for number, signal in enumerate(_listed(signals), 1):
    values = np.asarray(signal.get("values", ()), dtype=float)
    if samples in values.shape:
      columns |= signal_columns(f"{name}.{_label(signal) or f'signals({number})'}", values, samples)
  return columns


def signal_columns(name: str, values: np.ndarray, samples: int) -> dict[str, np.ndarray]:
  """A column for every part of a signal whose samples lie along one of its axes: `name`, or `name(1)`, `name(2)` …"""
  values = np.moveaxis(values, values.shape.index(samples), 0).reshape(samples, -1)
  parts = values.shape[1]
  return {name if parts == 1 else f"{name}({part + 1})": values[:, part] for part in range(parts)}


def _label(signal: Mapping[str, Any]) -> str:
  """What a signal is called: its label, else its axis' title in the scope, else its block's name."""
  for key in ("label", "title"):
    text = signal.get(key)
    if isinstance(text, str) and text.strip():
      return text.strip().strip("<>")
  block = signal.get("blockName")
  return block.rsplit("/", 1)[-1].strip() if isinstance(block, str) else ""
