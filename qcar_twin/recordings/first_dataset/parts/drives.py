"""The drives that logs hold, before any column is known: runs of one file apart, parts of one drive together."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from qcar_twin.atomic_io import write_text
from qcar_twin.recordings.first_dataset.parts.apart import runs_apart
from qcar_twin.recordings.first_dataset.parts.joined import as_csv, joined
from qcar_twin.recordings.first_dataset.place import Placed, copy_in, with_rows
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.recording import RecordingError


@dataclass(frozen=True)
class Drives:
  """The drives of a data set that is to be.

  Attributes:
    tables: one a drive; `Table.label` is its file's name in the data set's folder.
    made: those of them that no log is, so that they are to be written.
    said: a line for each of these, how it came about, and for each file that was left out.
    read: the logs that hold a sample, and what they hold.
  """

  tables: tuple[Table, ...]
  made: tuple[Table, ...]
  said: tuple[str, ...]
  read: tuple[tuple[Placed, Table], ...]

  def lay(self, folder: Path) -> list[Path]:
    """Write what is made and copy what is not; returns the paths of what was written."""
    written = [write_text(folder / table.label, as_csv(table)) for table in self.made]
    names = {table.label for table in self.tables}
    copy_in(folder, [log for log, _ in self.read if log.name in names and not log.made])
    return written


def drives_of(folder: Path, logs: Sequence[Placed]) -> Drives:
  """The drives that logs hold, once they lie in `folder`; nothing is written yet.

  Raises:
    RecordingError: no log holds a sample, one cannot be read, which files belong together cannot be told, or a file
      lies where one is to be written.
  """
  read = with_rows(logs)
  runs = runs_apart([table for _, table in read])
  whole = joined(runs.tables)
  written = {log.name for log, _ in read if log.made}
  made = whole.made or (*(table for table in runs.tables if table.label in written), *runs.made)
  for table in made:
    if (folder / table.label).exists():
      raise RecordingError(f"{folder / table.label}: is there already and is not replaced; remove it")
  return Drives(whole.tables, made, (*runs.said, *whole.said), tuple(read))
