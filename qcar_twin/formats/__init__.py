"""Files that logs come in: each reader turns one file into a `Table` of named columns. One reader per suffix."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from qcar_twin.formats.table import Table
from qcar_twin.recording import RecordingError

_READERS = {
  ".csv": ("columnar", "read_csv"),
  ".txt": ("columnar", "read_csv"),
  ".tsv": ("columnar", "read_csv"),
  ".parquet": ("columnar", "read_parquet"),
  ".npz": ("columnar", "read_npz"),
  ".mat": ("matlab", "read_mat"),
  ".mcap": ("rosbag", "read_bag"),
  ".bag": ("rosbag", "read_bag"),
  ".db3": ("rosbag", "read_bag"),
}
SUFFIXES = tuple(_READERS)


def _reader(path: Path, shown: str) -> Callable[[Path, str], Table]:
  suffix = ".db3" if path.is_dir() else path.suffix.lower()
  if suffix not in _READERS:
    raise RecordingError(
      f"{shown}: cannot read '{path.suffix}' files; readable are: {', '.join(SUFFIXES)} and ROS 2 bag folders"
    )
  module, function = _READERS[suffix]
  return getattr(import_module(f"qcar_twin.formats.{module}"), function)


def read_table(path: Path, shown: str | None = None) -> Table:
  """Read one log file; `shown` is its name in errors. Raises RecordingError: missing, unreadable, empty, broken."""
  shown = shown or path.name
  if not path.exists():
    raise RecordingError(f"{shown}: no such file in {path.parent}; check `file` in dataset.toml")
  read = _reader(path, shown)
  if path.is_file() and path.stat().st_size == 0:
    raise RecordingError(f"{shown}: the file is empty (0 bytes); record it again or remove it from dataset.toml")
  try:
    table = read(path, shown)
  except RecordingError:
    raise
  except OSError as error:
    raise RecordingError(f"{shown}: cannot be read ({error}); check the file and its permissions") from error
  except Exception as error:  # readers raise many kinds for damaged files
    raise RecordingError(
      f"{shown}: is damaged, or not the {path.suffix} file it is called ({error}); write it again"
    ) from error
  if table.rows == 0:
    raise RecordingError(f"{shown}: has column names but no rows; record it again or remove it from dataset.toml")
  return table


__all__ = ["SUFFIXES", "Table", "read_table"]
