"""A text file as a table: its lines as pyarrow reads them once their dialect is known, and what no table may be."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.compute
import pyarrow.csv

from qcar_twin.recordings.formats.columnar import opened, table_of_arrow
from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.formats.text.counted import with_stated_rate
from qcar_twin.recordings.formats.text.dialect import SPACES, Dialect, by_tabs, dialect_of, without_comments
from qcar_twin.recordings.formats.text.echoed import with_fields
from qcar_twin.recordings.formats.text.groups import without_groups
from qcar_twin.recordings.formats.text.keyed import keyed_lines
from qcar_twin.recordings.formats.text.tagged import messages_of, tagged_samples
from qcar_twin.recordings.recording import RecordingError

# what spreadsheets, pandas, R and C write where there is no number
_BLANK = ("", "#N/A", "N/A", "n/a", "NA", "null", "NULL", "None", "-", "--", "#DIV/0!", "#NUM!", "#VALUE!", "-nan(ind)")
_NUMBER = r"^\s*[-+]?(\d+\.?\d*|\.\d+|inf|nan|NaN)([eE][-+]?\d+)?\s*$"  # what a number looks like in a text
_SHOWN = 40  # characters of a row
_TORN = 0.005  # a stated prior: of rows, those that a serial line tears; in more the header does not fit the file


def read_text(path: Path, label: str) -> Table:
  """Text with a header line, separated by commas, semicolons, tabs or blanks; a byte order mark and decimal commas are
  understood."""
  if (samples := tagged_samples(path)) is not None:
    return table_of_arrow(
      pyarrow.csv.read_csv(pyarrow.BufferReader(samples), pyarrow.csv.ReadOptions(use_threads=False)), label
    )
  if (messages := messages_of(path, label)) is not None:
    return messages
  if (keyed := keyed_lines(path, label)) is not None:
    return keyed
  dialect = dialect_of(path, label)
  table, notes = _whole_rows(path, label, dialect)
  if len(table.column_names) == 1:
    raise RecordingError(
      f"{label}: only one column was found ('{table.column_names[0][:60]}'); separate the columns by commas"
    )
  table = without_groups(table, dialect.decimal, dialect.groups, label)
  _refuse_words(table, label)
  if dialect.headless:
    table = table.rename_columns([f"column_{number}" for number in range(1, table.num_columns + 1)])
  made = dataclasses.replace(table_of_arrow(table, label), headless=dialect.headless, notes=notes)
  made = with_fields(made, table.schema.types, path) if dialect.headless else made
  return with_stated_rate(_dated(made, dialect), dialect.rate)


def _dated(table: Table, dialect: Dialect) -> Table:
  """The table with its clock counted from 1970, where its head states when it began."""
  if dialect.clock not in table or table.columns[dialect.clock].dtype == object:
    return table
  columns = dict(table.columns)
  columns[dialect.clock] = columns[dialect.clock] + dialect.began
  return dataclasses.replace(table, columns=columns)


def _whole_rows(path: Path, label: str, dialect: Dialect) -> tuple[pyarrow.Table, tuple[str, ...]]:
  """The rows that have a cell for each column, and a note on a few that have not, as where a serial line lost bytes.

  Raises:
    RecordingError: more rows than a few have another number of cells, or it is no table for another reason.
  """
  plain, error = False, None
  for plain in (False, True):
    try:
      return _parse(path, dialect, plain=plain), ()
    except pyarrow.ArrowInvalid as failed:
      error = failed
      if b"\n#" not in path.read_bytes():
        break
  if "Empty CSV" in str(error):
    raise RecordingError(f"{label}: the file is empty; record it again or remove it from dataset.toml") from error
  torn: list[pyarrow.csv.InvalidRow] = []

  def skip(row: pyarrow.csv.InvalidRow) -> str:
    torn.append(row)
    return "skip"

  try:
    table = _parse(path, dialect, plain=plain, misfit=skip)
  except pyarrow.ArrowInvalid:
    table = None
  if table is None or not torn:
    raise RecordingError(f"{label}: {error}") from error
  said = _misfit(torn[0], 0 if plain or dialect.separator == SPACES else dialect.skipped, dialect)
  if len(torn) <= _TORN * table.num_rows:
    more = f" and {len(torn) - 1} more" if len(torn) > 1 else ""
    return table, (f"{label}: {said}{more}; left out",)
  more = f"; {len(torn) - 1} more do{'es' if len(torn) == 2 else ''} not fit either" if len(torn) > 1 else ""
  cut = (
    " (the last row is often cut off when a logger is killed)"
    if torn[0].actual_columns < torn[0].expected_columns
    else ""
  )
  which = "those rows" if more else "that row"
  raise RecordingError(
    f"{label}: a row does not fit the header: {said}{more}; repair or delete {which}{cut}"
  ) from error


def _misfit(row: pyarrow.csv.InvalidRow, above: int, dialect: Dialect) -> str:
  """A row with another number of cells than the header, counted from 1 below it."""
  number = row.number - above - (not dialect.names and not dialect.headless)
  cells = f"{row.actual_columns} cell{'s' if row.actual_columns != 1 else ''}"
  begun = " ".join(row.text.split())
  shown = f"{begun[:_SHOWN]}{'…' if len(begun) > _SHOWN else ''}"
  return f"row {number} has {cells} where the header has {row.expected_columns} ('{shown}')"


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


def _parse(
  path: Path, dialect: Dialect, *, plain: bool = False, misfit: Callable[[pyarrow.csv.InvalidRow], str] | None = None
) -> pyarrow.Table:
  """The table that a file holds; `plain`: without the comments among its rows; `misfit`: what to do with a row of
  another number of cells, "skip" or "error"."""
  source, size, skipped = opened(path), path.stat().st_size, dialect.skipped
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
