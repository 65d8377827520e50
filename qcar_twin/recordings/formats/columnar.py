"""CSV, Parquet and NPZ: files that already are columns."""

from __future__ import annotations

import dataclasses
import os
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.compute
import pyarrow.csv
import pyarrow.parquet

from qcar_twin.recordings.formats.dates import seconds_of
from qcar_twin.recordings.formats.dialect import SPACES, Dialect, by_tabs, dialect_of, without_comments
from qcar_twin.recordings.formats.table import NO_ROWS, Clocked, Table, merge
from qcar_twin.recordings.formats.tagged import messages_of, tagged_samples
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import words_of

pyarrow.set_memory_pool(pyarrow.system_memory_pool())  # where pyarrow was imported before: see formats
pyarrow.scalar(0)  # imports pandas, if it is there, now and not under the bound that is for a file's contents

# what spreadsheets, pandas, R and C write where there is no number
_BLANK = ("", "#N/A", "N/A", "n/a", "NA", "null", "NULL", "None", "-", "--", "#DIV/0!", "#NUM!", "#VALUE!", "-nan(ind)")
_NUMBER = r"^\s*[-+]?(\d+\.?\d*|\.\d+|inf|nan|NaN)([eE][-+]?\d+)?\s*$"  # what a number looks like in a text
CLOCKS = {"t", "time", "times", "stamp", "stamps", "timestamp", "timestamps", "clock"}
_WIDEST = 16  # columns of an array that holds a row for each sample
_SHOWN = 40  # characters of a row
_LONG, _SIGNALS, _LISTED = 20, 200, 4  # rows and signals of a long table, and how many are named
# "Speed"|"MPH"|0.0|150.0|10, with some of its quotes read away
_RANGED = re.compile(r'^"?(?P<name>[^"|]+)"?\|"?(?P<unit>[^"|]*)"?\|[-+.\d]*\|[-+.\d]*\|\d+$')
UNNAMED = "unnamed"  # and its number: what a column without a name is called

READERS = {
  ".csv": "read_csv",
  ".txt": "read_csv",
  ".log": "read_csv",
  ".tsv": "read_csv",
  ".parquet": "read_parquet",
  ".npz": "read_npz",
}


def read_csv(path: Path, label: str) -> Table:
  """Text with a header line, separated by commas, semicolons, tabs or blanks; a byte order mark and decimal commas are
  understood."""
  if (samples := tagged_samples(path)) is not None:
    return _from_arrow(
      pyarrow.csv.read_csv(pyarrow.BufferReader(samples), pyarrow.csv.ReadOptions(use_threads=False)), label
    )
  if (messages := messages_of(path, label)) is not None:
    return messages
  dialect = dialect_of(path, label)
  try:
    try:
      table = _parse(path, dialect)
    except pyarrow.ArrowInvalid:
      if b"\n#" not in path.read_bytes():
        raise
      table = _parse(path, dialect, plain=True)
  except pyarrow.ArrowInvalid as error:
    if "Empty CSV" in str(error):
      raise RecordingError(f"{label}: the file is empty; record it again or remove it from dataset.toml") from error
    raise RecordingError(f"{label}: {_misfit(path, dialect) or error}") from error
  if len(table.column_names) == 1:
    raise RecordingError(
      f"{label}: only one column was found ('{table.column_names[0][:60]}'); separate the columns by commas"
    )
  _refuse_words(table, label)
  _refuse_long(table, label)
  if dialect.headless:
    table = table.rename_columns([f"column_{number}" for number in range(1, table.num_columns + 1)])
  return dataclasses.replace(_from_arrow(table, label), headless=dialect.headless)


def _refuse_words(table: pyarrow.Table, label: str) -> None:
  """A row of words among numbers makes text of every column: a header that is repeated, or units below it."""
  texts = [column for column in table.columns if pyarrow.types.is_string(column.type)]
  if not texts or len(texts) < 0.5 * table.num_columns:
    return
  like = pyarrow.compute.MatchSubstringOptions(_NUMBER)
  matched = [pyarrow.compute.call_function("match_substring_regex", [text], like) for text in texts]
  numbers = [flags.fill_null(False).to_numpy() for flags in matched]
  words = np.flatnonzero(~np.any(numbers, axis=0)).tolist()
  for row in words[:1]:
    cells = [str(column[row].as_py() or "").strip() for column in table.columns]
    if cells == [name.strip() for name in table.column_names]:
      raise RecordingError(
        f"{label}: row {row + 1} repeats the header, as where a logger was started again; delete that row, or split "
        "the file there"
      )
    if row == 0 and any(cells) and not any(re.match(_NUMBER, cell) for cell in cells) and len(words) < table.num_rows:
      said = ", ".join(cell for cell in cells if cell)
      raise RecordingError(
        f"{label}: row 1 holds words ({said[:60]}), perhaps units, and no numbers; delete that row; a unit may stand "
        "in a column's name, as in 'speed [km/h]'"
      )


def _refuse_long(table: pyarrow.Table, label: str) -> None:
  """A table with a row for every signal and time has one column of names and one of values."""
  names = table.column_names
  texts = [name for name, column in zip(names, table.columns, strict=True) if pyarrow.types.is_string(column.type)]
  values = [name for name in names if words_of(name)[-1:] in (("value",), ("data",), ("val",))]
  if len(texts) != 1 or len(values) != 1 or names.count(texts[0]) != 1 or table.num_rows < _LONG:
    return
  signals = table.column(texts[0]).unique().to_pylist()
  if 1 < len(signals) <= _SIGNALS and None not in signals:
    listed = ", ".join(map(str, signals[:_LISTED])) + (" …" if len(signals) > _LISTED else "")
    raise RecordingError(
      f"{label}: is a long table: '{texts[0]}' has the names of {len(signals)} signals ({listed}) and '{values[0]}' "
      f'their values; give each a column of its own, as pandas\' table.pivot_table(index="time", '
      f'columns="{texts[0]}", values="{values[0]}").reset_index() does'
    )


def read_parquet(path: Path, label: str) -> Table:
  """A Parquet file with flat numeric columns; null means no sample."""
  try:
    table = pyarrow.parquet.read_table(_opened(path), use_threads=False, pre_buffer=False)
  except (pyarrow.ArrowException, OSError) as error:
    if isinstance(error, MemoryError) or getattr(error, "errno", None):
      raise
    raise RecordingError(f"{label}: is not a readable Parquet file ({error}); write it again") from error
  return _from_arrow(table, label)


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
  """The arrays, those with a row for each sample as their columns: `state[0]`, and `gyro.x` to `gyro.z` of three."""
  out = {}
  for name, array in arrays.items():
    if array.ndim != 2 or not 1 < array.shape[1] <= _WIDEST < array.shape[0]:
      out[name] = array
      continue
    marks = [f".{axis}" for axis in "xyz"] if array.shape[1] == 3 else [f"[{k}]" for k in range(array.shape[1])]
    out |= {f"{name}{mark}": column for mark, column in zip(marks, array.T, strict=True)}
  return out


def _clocked(vectors: dict[str, np.ndarray]) -> list[Clocked]:
  """Vectors of one length each with the one among them that is a clock by its name and rises; none where a length has
  none, or several."""
  groups = []
  for length in sorted({vector.size for vector in vectors.values()} - {1}):
    same = {name: vector for name, vector in vectors.items() if vector.size == length}
    clocks = [name for name, vector in same.items() if set(words_of(name)) & CLOCKS and (np.diff(vector) > 0.0).all()]
    if len(clocks) != 1:
      return []
    groups.append(Clocked(same.pop(clocks[0]), same))
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


def _misfit(path: Path, dialect: Dialect) -> str:
  """The first row with another number of cells than the header, counted from 1 below it, how many more there are, and
  what to do; "" where the file cannot be read for another reason."""
  rows: list[pyarrow.csv.InvalidRow] = []

  def skip(row: pyarrow.csv.InvalidRow) -> str:
    rows.append(row)
    return "skip"

  plain = b"\n#" in path.read_bytes()
  try:
    _parse(path, dialect, plain=plain, misfit=skip)
  except pyarrow.ArrowInvalid:
    return ""
  if not rows:
    return ""
  first, above = rows[0], 0 if plain or dialect.separator == SPACES else dialect.skipped
  number = first.number - above - (not dialect.names and not dialect.headless)
  cells = lambda count: f"{count} cell{'s' if count != 1 else ''}"
  said = f"row {number} has {cells(first.actual_columns)} where the header has {first.expected_columns}"
  begun = " ".join(first.text.split())
  more = f"; {len(rows) - 1} more do{'es' if len(rows) == 2 else ''} not fit either" if len(rows) > 1 else ""
  torn = (
    " (the last row is often cut off when a logger is killed)" if first.actual_columns < first.expected_columns else ""
  )
  return (
    f"a row does not fit the header: {said} ('{begun[:_SHOWN]}{'…' if len(begun) > _SHOWN else ''}'){more}; "
    f"repair or delete {'those rows' if more else 'that row'}{torn}"
  )


def _parse(
  path: Path, dialect: Dialect, *, plain: bool = False, misfit: Callable[[pyarrow.csv.InvalidRow], str] | None = None
) -> pyarrow.Table:
  """The table that a file holds; `plain`: without the comments among its rows; `misfit`: what to do with a row of
  another number of cells, "skip" or "error"."""
  source, size, skipped = _opened(path), path.stat().st_size, dialect.skipped
  spaced = dialect.separator == SPACES
  if plain or spaced or dialect.encoding not in ("utf-8", "utf-8-sig"):
    # pyarrow's own conversion takes its memory from the pool that reserves so much
    text = path.read_bytes().decode(dialect.encoding)
    text = without_comments(text, skipped) if plain or spaced else text
    data = (by_tabs(text) if spaced else text).encode()
    source, size, skipped = pyarrow.BufferReader(data), len(data), 0 if plain or spaced else skipped
  whole = min(max(size + 1, 1 << 16), (1 << 31) - 1)  # column types come from the first block: take it all
  return pyarrow.csv.read_csv(
    source,
    read_options=pyarrow.csv.ReadOptions(
      use_threads=False,
      block_size=whole,
      skip_rows=skipped,
      column_names=list(dialect.names) or None,
      autogenerate_column_names=dialect.headless,
    ),
    parse_options=pyarrow.csv.ParseOptions(delimiter="\t" if spaced else dialect.separator, invalid_row_handler=misfit),
    convert_options=pyarrow.csv.ConvertOptions(
      null_values=list(_BLANK), strings_can_be_null=True, decimal_point=dialect.decimal
    ),
  )


def _opened(path: Path) -> pyarrow.NativeFile:
  """The file, by the bytes of its name: pyarrow takes text for UTF-8, which names are not in every locale."""
  return pyarrow.OSFile(os.fsencode(path))


def _from_arrow(table: pyarrow.Table, label: str) -> Table:
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
