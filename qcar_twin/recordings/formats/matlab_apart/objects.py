"""MATLAB objects that hold a clock, `timeseries` first of all, and files of version 7.3, read by mat-io.

Runs in a process of its own (`apart`). A timeseries keeps its values in `Data_`; its times in `Time_`, or, where they
are uniform, only as `Start_`, `Increment_` and `Length` of its `tsdata.timemetadata`, with the name of their unit.
Whatever holds timeseries (a structure, a Simulink Dataset, a Signal) is searched for them.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from qcar_twin.extras import extra
from qcar_twin.recordings.formats.apart import Group
from qcar_twin.recordings.formats.matlab import is_7_3
from qcar_twin.recordings.formats.matlab_apart.content import columns_of, signal_columns
from qcar_twin.recordings.recording import RecordingError

with extra("Reading MATLAB objects"):
  from matio import load_from_mat

_SECONDS = {
  "weeks": 604800.0, "days": 86400.0, "hours": 3600.0, "minutes": 60.0, "seconds": 1.0,
  "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9,
}  # fmt: skip
_DEEPEST = 12  # objects in objects: a Dataset's signal's values are four
_SERIES = "timeseries"


def groups(path: Path, label: str) -> Iterator[Group]:
  """Clock and columns of every timeseries; of a file of version 7.3 also those of its other variables.

  Raises RecordingError: not readable.
  """
  try:
    with warnings.catch_warnings():
      warnings.simplefilter("ignore")  # of classes that it leaves as they are
      variables = load_from_mat(str(path), raw_data=True)
  except MemoryError:
    raise
  except Exception as error:  # the reader raises many kinds for damaged files
    raise RecordingError(f"{label}: is not a readable .mat file ({error}); save it again with -v7") from error
  new_version = is_7_3(path)
  for name, value in variables.items():
    if name.startswith("__"):
      continue
    yield from _series(name, value, _DEEPEST)
    if new_version:
      yield from columns_of(name, _simplified(value, _DEEPEST))


def _series(name: str, value: Any, depth: int) -> Iterator[Group]:
  """The timeseries in a value, called by the way to them."""
  value = _only(value)
  if depth == 0:
    return
  properties = _properties(value)
  if properties and getattr(value, "classname", None) == _SERIES:
    yield from _clocked(name, properties)
  elif properties:
    called = _text(properties.get("Name")) or _text(properties.get("BlockPath"))
    for inside in properties.values():
      yield from _series(f"{name}.{called}" if called else name, inside, depth - 1)
  elif isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
    for field in value.dtype.names:
      yield from _series(f"{name}.{field}", value.ravel()[0][field], depth - 1)
  elif isinstance(value, np.ndarray) and value.dtype == object:
    for number, inside in enumerate(value.ravel(), 1):
      called = _text(_properties(inside).get("Name"))
      yield from _series(name if called or value.size == 1 else f"{name}({number})", inside, depth - 1)


def _clocked(name: str, series: Mapping[str, Any]) -> Iterator[Group]:
  values = np.asarray(_first(series, "Data_", "Data"), dtype=float)
  about = _properties(_first(series, "TimeInfo_", "TimeInfo"))
  clock = _numbers(_first(series, "Time_", "Time"))
  clock = clock if clock.size else _numbers(_first(about, "Time_", "Time"))
  start, step = (_numbers(_first(about, key, key.rstrip("_"))) for key in ("Start_", "Increment_"))
  if not clock.size and step.size:
    length = _numbers(_first(about, "Length", "Length_"))
    count = int(length[0]) if length.size else max(values.shape, default=0)
    clock = (start[0] if start.size else 0.0) + step[0] * np.arange(count)
  if clock.size and clock.size in values.shape:
    clock = clock * _SECONDS.get(_text(_first(about, "Units", "Units_")), 1.0)
    yield clock, signal_columns(name, values, clock.size)


def _properties(value: Any) -> Mapping[str, Any]:
  """Of a MATLAB object by name; none of what is no object."""
  properties = getattr(_only(value), "properties", None)
  return properties if isinstance(properties, Mapping) else {}


def _first(properties: Mapping[str, Any], *keys: str) -> Any:
  return next((properties[key] for key in keys if key in properties), np.empty(0))


def _numbers(value: Any) -> np.ndarray:
  value = np.asarray(value)
  return value.astype(float).ravel() if value.dtype.kind in "fiub" else np.empty(0)


def _text(value: Any) -> str:
  value = np.asarray(value if isinstance(value, (str, np.ndarray)) else "")
  return str(value.ravel()[0]).strip() if value.dtype.kind == "U" and value.size == 1 else ""


def _only(value: Any) -> Any:
  """What an array of one object holds."""
  while isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
    value = value.ravel()[0]
  return value


def _simplified(value: Any, depth: int) -> Any:
  """Structures as mappings, arrays without dimensions of one, as SciPy's reader simplifies them."""
  value = _only(value)
  if not isinstance(value, np.ndarray) or depth == 0:
    return value
  if value.dtype.names:
    records = [{f: _simplified(row[f], depth - 1) for f in value.dtype.names} for row in value.ravel()]
    return records[0] if len(records) == 1 else records
  if value.dtype.kind == "U":
    return _text(value)
  return np.squeeze(value) if value.size != 1 else value.ravel()[0]
