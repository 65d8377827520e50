"""JSON: an object a line, as web services, robots and Donkeycar's tubs log; or one document of samples or columns, as
JavaScript, Python and pandas write it."""

from __future__ import annotations

import dataclasses
import datetime
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qcar_twin.recordings.formats.columnar import CLOCKS, table_of_arrays
from qcar_twin.recordings.formats.dates import seconds_of
from qcar_twin.recordings.formats.generalised import axes_of
from qcar_twin.recordings.formats.hierarchy.documents import runs_in, units_in, with_units
from qcar_twin.recordings.formats.table import NO_ROWS, NoSamples, SeveralRecordings, Table
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import VECTORS, words_of

READERS = {
  ".jsonl": "read_json_lines",
  ".ndjson": "read_json_lines",
  ".catalog": "read_json_lines",
  ".json": "read_json",
}
_LEAST = 2  # samples: fewer are no log
_DATE = 7  # parts of a date, down to the millisecond: a longer list of times is a block of samples
_CLOCKED = "where it is a log, write an object a sample, or lists of one length"
_NO_LIST = "holds no list of samples; name the file of the log itself, or write an object a sample"


def read_json_lines(path: Path, label: str) -> Table:
  """A column for every value of the objects, `imu.gyro.z` where they are nested; blank where an object has none."""
  return _of_lines(_text(path), label)


def read_json(path: Path, label: str) -> Table:
  """One document: a list of objects, lists by name, a list of rows, or pandas' `to_json`; or an object a line.

  Raises NoSamples where a document holds no list of samples, as a description of a log or a result does, and
  SeveralRecordings where a list holds runs, each with its samples.
  """
  text = _text(path)
  try:
    said = json.loads(text)
  except (ValueError, RecursionError) as error:
    if text.lstrip().startswith("{") and "Extra data" in str(error):
      return _of_lines(text, label)
    if "Extra data" in str(error) and _all_json(text):  # as a Donkeycar tub's manifest, a list of names first
      raise NoSamples(f"{label}: {_NO_LIST}") from error
    raise RecordingError(
      f"{label}: is no JSON ({error}); repair that place (the end is often cut off when a logger is killed)"
    ) from error
  return _of_document(said, label)


def _of_document(said: Any, label: str) -> Table:
  """The table of a document, with the units that it states."""
  if runs := runs_in(said, _is_clock):
    units = units_in(said)
    tables = {name: with_units(_of_samples(run, f"{label}/{name}"), units) for name, run in runs.items()}
    if len(tables) > 1:
      raise SeveralRecordings(label, tables)
    return dataclasses.replace(next(iter(tables.values())), label=label)
  return with_units(_of_samples(said, label), units_in(said))


def _of_samples(said: Any, label: str) -> Table:
  """One recording's."""
  if isinstance(said, dict):
    said = _split(said) or _by_index(said) or said
  if isinstance(said, list):
    return _of_list(said, label)
  series = list(_lists("", said)) if isinstance(said, dict) else []
  if len(rows := [values for _, values in series if isinstance(values[0], (dict, list))]) == 1:
    return _of_list(rows[0], label)
  sizes = {len(values) for values in rows} or {len(values) for _, values in series}
  vectors: dict[str, np.ndarray] = {}
  for name, values in series:
    if all(isinstance(value, dict) for value in values):
      vectors |= {f"{name}.{key}": column for key, column in _of_records(values, label).columns.items()}
    elif len(values) in sizes and not any(isinstance(value, (dict, list)) for value in values):
      vectors[name] = _column(values)
  if all(vector.dtype == object for vector in vectors.values()):
    raise NoSamples(f"{label}: {_NO_LIST}")
  if len({vector.size for vector in vectors.values()}) > 1 and not any(map(_is_clock, vectors)):
    raise NoSamples(f"{label}: holds lists of several lengths and no clock, as results do; {_CLOCKED}")
  shared = next(iter(vectors)).rpartition(".")[0] + "."
  alike = all(name.startswith(shared) for name in vectors)
  return table_of_arrays({name.removeprefix(shared) if alike else name: v for name, v in vectors.items()}, label)


def _text(path: Path) -> str:
  """What a file says, in UTF-8, or in UTF-16 with its mark."""
  data = path.read_bytes()
  return data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")


def _all_json(text: str) -> bool:
  """Whether every line is a JSON document of its own."""
  try:
    for line in filter(str.strip, text.splitlines()):
      json.loads(line)
  except (ValueError, RecursionError):
    return False
  return True


def _is_clock(name: str) -> bool:
  """Whether the last part of a name, `imu.stamp`, says time."""
  return bool(set(words_of(name.rpartition(".")[2])) & CLOCKS)


def _of_lines(text: str, label: str) -> Table:
  records: list[Mapping[str, Any]] = []
  for number, line in enumerate(text.splitlines(), 1):
    if not line.strip():
      continue
    try:
      said = json.loads(line)
    except (ValueError, RecursionError) as error:
      raise RecordingError(
        f"{label}: line {number} is no JSON ({error}); repair or delete that line (the last one is often cut off when "
        "a logger is killed)"
      ) from error
    if not isinstance(said, dict):
      raise RecordingError(f"{label}: line {number} is no JSON object; write one object a line, with a name per value")
    records.append(said)
  return _of_records(records, label)


def _of_list(said: Sequence[Any], label: str) -> Table:
  """A sample each: objects, or rows of as many numbers, whose columns have no names."""
  if all(isinstance(record, dict) for record in said):
    return _of_records(said, label)
  if not any(isinstance(record, (dict, list)) for record in said):
    raise NoSamples(f"{label}: {_NO_LIST}")
  if len(said) < _LEAST or not all(isinstance(row, list) for row in said):
    odd = next((k for k, record in enumerate(said, 1) if not isinstance(record, dict)), 1)
    raise RecordingError(f"{label}: element {odd} is no JSON object; write one object a sample, with a name per value")
  if odd := next((k for k, row in enumerate(said, 1) if len(row) != len(said[0])), 0):
    raise RecordingError(
      f"{label}: row {odd} has {len(said[odd - 1])} values, and the first {len(said[0])}; repair or delete that row"
    )
  columns = {f"column_{k}": _column([row[k - 1] for row in said]) for k in range(1, len(said[0]) + 1)}
  return Table(label, columns, dict.fromkeys(columns, NO_ROWS), headless=True)


def _of_records(records: Sequence[Mapping[str, Any]], label: str) -> Table:
  if (name := next((name for record in records[:1] for name in _blocks("", record)), None)) is not None:
    raise NoSamples(f"{label}: '{name}' is a list of times in one object, as of a watch; write an object a sample")
  rows = [dict(_values("", record)) for record in records]
  names = dict.fromkeys(name for row in rows for name in row)
  columns = {name: _column([row.get(name) for row in rows]) for name in names}
  columns = {name: column for name, column in columns.items() if column.dtype != object}
  written = {
    name: np.array([k for k, r in enumerate(rows) if r.get(name) != r.get(name)], dtype=int) for name in columns
  }
  axes = {name: columns[element] for name, element in _axes(columns).items() if name not in columns}
  written |= {name: written[element] for name, element in _axes(columns).items() if name in axes}
  return Table(label, columns | axes, written)


def _axes(columns: Mapping[str, np.ndarray]) -> dict[str, str]:
  """Names by axes for the elements of lists of three -> their columns: `imu.a.x` -> `imu.a[0]`. None for vectors whose
  elements are known by their number, `gyro[2]`."""
  out = {}
  for first in columns:
    stem = first.removesuffix("[0]")
    elements = [f"{stem}[{k}]" for k in range(3)]
    if first != elements[0] or f"{stem}[3]" in columns or set(words_of(stem)) & VECTORS:
      continue
    if elements[1] in columns and elements[2] in columns:
      marks = axes_of(stem, np.stack([columns[element] for element in elements])) or ()
      out |= {f"{stem}.{mark}": element for mark, element in zip(marks, elements, strict=False)}
  return out


def _values(before: str, said: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
  """Names and values of an object and of those within it."""
  for key, value in said.items():
    if isinstance(value, dict):
      yield from _values(f"{before}{key}.", value)
    elif isinstance(value, list):
      yield from ((f"{before}{key}[{k}]", v) for k, v in enumerate(value) if not isinstance(v, (dict, list)))
    elif value is not None:
      yield f"{before}{key}", value


def _blocks(before: str, said: Mapping[str, Any]) -> Iterator[str]:
  """Names of the lists in an object that hold times of many samples."""
  for key, value in said.items():
    if isinstance(value, dict):
      yield from _blocks(f"{before}{key}.", value)
    elif isinstance(value, list) and len(value) > _DATE and _is_clock(key):
      yield f"{before}{key}"


def _column(values: Sequence[Any]) -> np.ndarray:
  """Numbers, with NaN where there is none; stamps of the day in seconds; words stay words."""
  words = [value for value in values if isinstance(value, str)]
  if not words:
    return np.array([float(v) if isinstance(v, (int, float)) else np.nan for v in values])
  if all(isinstance(value, str) or value is None for value in values):
    seconds = _iso(values) if "T" in words[0] or "-" in words[0] else None
    if seconds is None:
      seconds = seconds_of(list(values))
    if seconds is not None:
      return seconds
  try:
    return np.array([np.nan if value is None else float(value) for value in values])
  except (TypeError, ValueError):
    return np.array(values, dtype=object)


def _iso(texts: Sequence[str | None]) -> np.ndarray | None:
  """Seconds since 1970 of ISO 8601 stamps, in UTC where they name no zone; None where a text is none."""
  try:
    stamps = [None if text is None else datetime.datetime.fromisoformat(text) for text in texts]
  except ValueError:
    return None
  zoned = [s and (s if s.tzinfo else s.replace(tzinfo=datetime.UTC)) for s in stamps]
  return np.array([np.nan if stamp is None else stamp.timestamp() for stamp in zoned])


def _split(said: Mapping[str, Any]) -> list[dict[str, Any]] | None:
  """pandas' orients "split" and "table": names, and rows of values."""
  names, rows = said.get("columns"), said.get("data")
  if isinstance(said.get("schema"), dict) and isinstance(rows, list) and all(isinstance(row, dict) for row in rows):
    return rows
  if not isinstance(names, list) or not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
    return None
  return [dict(zip(map(str, names), row, strict=False)) for row in rows]


def _by_index(said: Mapping[str, Any]) -> list[dict[str, Any]] | None:
  """pandas' orients "columns" and "index": values by name and number of the row, or by number and name."""
  inner = list(said.values())
  if not inner or not all(isinstance(column, dict) and column for column in inner):
    return None
  if all(key.isdigit() for key in said) and len(said) >= _LEAST:
    return inner
  if all(column.keys() == inner[0].keys() for column in inner) and all(key.isdigit() for key in inner[0]):
    return [{name: column[key] for name, column in said.items()} for key in inner[0]]
  return None


def _lists(before: str, said: Mapping[str, Any]) -> Iterator[tuple[str, list[Any]]]:
  """Names and values of the lists of samples in an object and in those within it."""
  for key, value in said.items():
    if isinstance(value, dict):
      yield from _lists(f"{before}{key}.", value)
    elif isinstance(value, list) and len(value) >= _LEAST:
      yield f"{before}{key}", value
