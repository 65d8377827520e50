"""Is a folder one recording, with a table per topic, or does it hold recordings?"""

from collections.abc import Sequence
from pathlib import Path

from qcar_twin.recordings.first_dataset.columns import Columns
from qcar_twin.recordings.first_dataset.parts.joined import topics_of_one_drive
from qcar_twin.recordings.formats import Table, read_table
from qcar_twin.recordings.formats.folder import stamps_of, tables_in
from qcar_twin.recordings.formats.table import NoSamples
from qcar_twin.recordings.recording import RecordingError

_TOPICS = 3  # tables of one recording; two are a drive's log and a motion capture's, which clock or motion joins


def is_one_recording(folder: Path) -> bool:
  """Whether the tables of a folder are topics of one run, as a bag is exported to.

  Each of three and more has a clock, and their times overlap. Clocks of dates settle it, as a car drives once at a
  time. Else the tables' columns differ, or folders beside this one hold tables of the same names. Tables of the same
  columns that each have commands and motion are recordings of their own, and so are tables that cannot be read.
  """
  files = tables_in(folder)
  if len(files) < _TOPICS:
    return False
  tables: list[Table] = []
  span = (float("-inf"), float("inf"))
  for file in files:
    try:
      table = read_table(file, file.name)
    except NoSamples:
      continue
    except RecordingError:  # said where it is read by itself
      return False
    clock = stamps_of(table)
    if clock is None:
      continue
    span = max(span[0], float(clock[1].min())), min(span[1], float(clock[1].max()))
    if span[0] > span[1]:  # of recordings mostly the second file tells
      return False
    tables.append(table)
  each = [Columns((table,)) for table in tables]
  return len(tables) > 1 and topics_of_one_drive(tables, each, _repeated_beside(folder, files)) is not None


def _repeated_beside(folder: Path, files: Sequence[Path]) -> bool:
  """Whether a folder beside this one holds tables of the same names: a topic keeps its name from run to run."""
  names = {path.name for path in files}
  beside = [path for path in folder.parent.iterdir() if path.is_dir() and path.name != folder.name]
  return any({path.name for path in tables_in(path)} == names for path in beside)
