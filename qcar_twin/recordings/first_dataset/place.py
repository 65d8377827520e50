"""Where the logs of a new data set lie: those inside its folder stay, others are copied in; nothing is replaced."""

import dataclasses
import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from qcar_twin.atomic_io import whole_file
from qcar_twin.recordings.first_dataset.columns import Columns, guess_columns
from qcar_twin.recordings.first_dataset.parts.runs import is_one_recording
from qcar_twin.recordings.first_dataset.parts.torn import COMMANDS, MANY, MOTION, is_clock
from qcar_twin.recordings.formats import PACKED, read_table, readers
from qcar_twin.recordings.formats.folder import is_bag
from qcar_twin.recordings.formats.table import NoSamples, SeveralRecordings, Table
from qcar_twin.recordings.formats.text import READERS as TEXTS
from qcar_twin.recordings.formats.text.dialect import holds_samples
from qcar_twin.recordings.formats.text.encodings import LONGEST_LINE
from qcar_twin.recordings.formats.text.keyed import names_its_values
from qcar_twin.recordings.formats.text.tagged import holds_messages
from qcar_twin.recordings.manifest import FILE_NAME
from qcar_twin.recordings.recording import RecordingError

_LISTED = 3  # files that are named
_LATER = re.compile(r"\[[1-9]\d*\]$")
_CHANNELS = 2  # columns that are channels by their names, of a log whose clock was not logged
_NOT_IN_TIME = f"no column of {MANY} rows and more is a clock, so that it is no log"
_UNFIT = re.compile(r"[^\w.-]+")  # for a file's name
_DOCUMENTS = (".json", ".jsonl", ".ndjson")  # logs, or results, settings and descriptions of logs
_MAY_BE_NOTES = set(TEXTS) - {".csv", ".tsv", ".vbo", ".lp"}  # of a folder those that hold a table are logs
_NOTES = (".txt", ".log")


@dataclass(frozen=True)
class Placed:
  """One log: where it is, and its name within the data set's folder, with forward slashes. `made`: it is one of several
  recordings of its source, and is to be written."""

  source: Path
  name: str
  copied: bool
  made: bool = False


def logs_of(paths: Sequence[Path], home: Path | None = None) -> list[Path]:
  """The logs that are meant, in natural order: files, bags, folders of a table per topic, and everything readable below
  other folders.

  Args:
    home: of the data set; a folder that holds logs and is none, whatever they are.

  Raises:
    RecordingError: a path that is not there, or a folder without a log.
  """
  logs: list[Path] = []
  for path in paths:
    if not path.exists():
      raise RecordingError(f"{path}: no such file or folder")
    at_home = home is not None and path.resolve() == home.resolve()
    if path.is_file() or is_bag(path) or (not at_home and is_one_recording(path)):
      logs.append(path)
    else:
      logs += _below(path)
  return sorted(dict.fromkeys(logs), key=lambda path: _natural(path.as_posix()))


def _below(folder: Path) -> list[Path]:
  known = set(readers())
  folders = [path for path in folder.rglob("*") if path.is_dir()]
  bags = {path for path in folders if is_bag(path) or is_one_recording(path)}
  shown = lambda path: not any(part.startswith(".") for part in path.relative_to(folder).parts)
  files = [path for path in folder.rglob("*") if path.is_file() and not bags & set(path.parents) and shown(path)]
  seen = [path for path in files if path.suffix.lower() in known and not _is_note(path)]
  others = sorted(path.name for path in files if path not in seen and path.name != FILE_NAME)
  seen = [*filter(shown, bags), *seen]
  if not seen:
    but = f" but {_listed(others)}" if others else ", it is empty"
    raise RecordingError(
      f"{folder}: holds no log{but}; readable are {', '.join(sorted(known))}, ROS 2 bag folders and folders of tables,"
      " one per topic"
    )
  if others:
    print(f"left out: {_listed(others)}")
  return seen


def _is_note(path: Path) -> bool:
  """Whether a file of a kind that people write notes into is one: no table of many rows, or one in which no column is a
  clock and hardly one a channel. A table that cannot be read is none, so that whoever reads it says why."""
  if path.suffix.lower() not in _MAY_BE_NOTES:
    return False
  if not (holds_messages(path) or names_its_values(path) or holds_samples(path)):
    return True
  try:
    guesses = guess_columns(Columns((read_table(path),)))
  except NoSamples:
    return True
  except RecordingError:
    return False
  return "time" not in guesses and len(guesses) < _CHANNELS


def _listed(names: Sequence[str]) -> str:
  """Files that are no logs by their names and contents, and what to do with them."""
  listed = ", ".join(names[:_LISTED]) + (f" and {len(names) - _LISTED} more" if len(names) > _LISTED else "")
  if packed := next((name for name in names if Path(name).suffix.lower() in PACKED), None):
    return f"{listed} (unpack {packed} first)"
  text = next((name for name in names if Path(name).suffix.lower() in TEXTS), None)
  return f"{listed} ({f'name {text} itself' if text else 'export it as .csv'} if it is a log)"


def _natural(name: str) -> list[tuple[bool, int, str]]:
  """Sorts `step_9` before `step_10`."""
  return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", name)]


def placed(folder: Path, logs: Sequence[Path]) -> list[Placed]:
  """Names within the data set's folder, below what the logs outside it have in common.

  Raises:
    RecordingError: there is a dataset.toml already, or another file where a log would be copied to.
  """
  if (folder / FILE_NAME).exists():
    raise RecordingError(
      f"{folder / FILE_NAME}: is there already and is not replaced; remove it, or name another folder"
    )
  inside = folder.resolve()
  outside = [path.resolve() for path in logs if not path.resolve().is_relative_to(inside)]
  common = Path(os.path.commonpath([path.parent for path in outside])) if outside else inside
  places = []
  for path in logs:
    there = path.resolve()
    copied = not there.is_relative_to(inside)
    name = there.relative_to(common if copied else inside).as_posix()
    if copied and (folder / name).exists():
      raise RecordingError(f"{folder / name}: is there already and is not replaced; remove it, or name another folder")
    places.append(Placed(path, name, copied))
  return places


def copy_in(folder: Path, logs: Sequence[Placed]) -> None:
  """Copy the logs from outside, each whole or not at all."""
  for log in logs:
    if log.copied:
      with whole_file(folder / log.name) as part:
        if log.source.is_dir():
          shutil.copytree(log.source, part)
        else:
          shutil.copyfile(log.source, part)


def with_rows(logs: Sequence[Placed]) -> list[tuple[Placed, Table]]:
  """The logs that hold a sample, with their content; each that holds none is said and left out, and so is a document
  whose lists are none of samples, beside logs.

  Raises:
    RecordingError: none holds a sample, or one cannot be read.
  """
  read: list[tuple[Placed, Table]] = []
  for log in logs:
    try:
      read.append((log, read_table(log.source, log.name)))
    except SeveralRecordings as error:
      print(f"{log.name}: holds {len(error.tables)} recordings, each written as a file of its own")
      for table in _written_apart(log, error):
        read.append((Placed(log.source, table.label, copied=False, made=True), table))
        for note in table.notes:  # which no longer stand in the file that is written
          print(f"  {note}")
    except NoSamples as error:
      if len(logs) == 1:
        raise
      print(f"left out: {str(error).partition(';')[0]}")
  if not read:
    raise RecordingError("no log holds a sample; record again, or name other files")
  drives = [(log, table) for log, table in read if not _may_be_results(log.source) or _in_time(table)]
  if not drives:
    return read
  for log, _ in read:
    if all(log is not other for other, _ in drives):
      print(f"left out: {log.name}: {_NOT_IN_TIME}")
  return drives


def _written_apart(log: Placed, several: SeveralRecordings) -> list[Table]:
  """A file's recordings, each with the name of a file of its own: `campaign_trial_1.csv` of `campaign.h5`."""
  stem = PurePosixPath(log.name).with_suffix("").as_posix()
  names = [f"{stem}_{_UNFIT.sub('_', name)}.csv" for name in several.tables]
  names = [name if names.count(name) == 1 else f"{stem}_{k}.csv" for k, name in enumerate(names, 1)]
  return [dataclasses.replace(table, label=name) for table, name in zip(several.tables.values(), names, strict=True)]


def is_document(path: Path) -> bool:
  """Whether a file holds results or settings in JSON and is no log: it has no samples, or they have no clock. What
  cannot be read is none, so that whoever reads it says why."""
  if not _may_be_results(path):
    return False
  try:
    return not _in_time(read_table(path))
  except NoSamples:
    return path.stat().st_size > 0  # an empty file is a run that was aborted
  except RecordingError:
    return False


def _may_be_results(path: Path) -> bool:
  return path.suffix.lower() in _DOCUMENTS and path.is_file()


def _in_time(table: Table) -> bool:
  """Whether the rows are samples: many, of which a column is a clock by its name, or rises as one beside a channel's.
  Few are those of a drive that was broken off, where a clock by its name stands beside commands and motion.

  The later values of a list are none by its name: a stamp's begin with what counts most, and a scan's with a size.
  """
  guesses = guess_columns(Columns((table,))) if table.rows > 1 else {}
  if "time" not in guesses:
    return False
  clock = guesses["time"].column
  by_name = is_clock(clock) and not _LATER.search(clock)
  if table.rows < MANY:
    return by_name and bool(guesses.keys() & {*COMMANDS}) and bool(guesses.keys() & {*MOTION})
  return table.headless or len(guesses) > 1 or by_name


def without_header(read: Sequence[tuple[Placed, Table]]) -> list[str]:
  """A line on the logs whose columns have no names, with the cure; none where all have."""
  logs = [(log, table) for log, table in read if table.headless]
  if not logs:
    return []
  log, names = logs[0][0], list(logs[0][1].columns)
  others = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
  beside = _names_beside(log.source, len(names))
  perhaps = f"; {beside} next to {'them' if others else 'it'} may have them" if beside else ""
  return [
    f"no header: {log.name}{others}, whose columns are called {names[0]} to {names[-1]}: write a first line of names "
    "into each file and run new again into another folder, or name each in dataset.toml, columns = "
    f'["time", "motor_speed", …], and where [channels] has it{perhaps}'
  ]


def _names_beside(log: Path, count: int) -> str:
  """The name of a text next to a log that has as many lines, or words in its one line, as the log has columns."""
  for path in sorted(log.parent.iterdir()):
    if path == log or path.suffix.lower() not in _NOTES or not path.is_file() or path.stat().st_size > LONGEST_LINE:
      continue
    lines = [line for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    if count in (len(lines), len(re.split(r"[,;\s]+", lines[0].strip())) if len(lines) == 1 else 0):
      return path.name
  return ""
