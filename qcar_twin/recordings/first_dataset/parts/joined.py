"""Files that hold parts of one drive, a topic each, as one log: rows by their clocks, blank where one has no sample."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qcar_twin.recordings.first_dataset.columns import Columns, Guess, guess_columns
from qcar_twin.recordings.first_dataset.parts.pairing import Group, clocked, paired, part_of, words_of_file
from qcar_twin.recordings.first_dataset.parts.topics import by_topic
from qcar_twin.recordings.first_dataset.parts.torn import COMMANDS, MOTION, is_clock
from qcar_twin.recordings.formats.table import Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError

JOINED = "joined.csv"
# of the longest file's time, during which all of them have rows: parts of one drive begin and end alike
_TOGETHER = 0.5
_DATE = 1e6  # s, beyond which a clock is a date's
_ALIKE = 0.5  # of the columns of the file with fewer: a message of one kind may repeat a name of another


@dataclass(frozen=True)
class Joined:
  """Logs as drives.

  Attributes:
    tables: one a drive.
    made: those of them that are to be written, of the name in `label`; none where every file is a drive of its own.
    said: a line for each, how it came about, and for each file that was left out.
    first: of a single drive the file with its commands, where it was joined of two kinds of files.
  """

  tables: tuple[Table, ...]
  made: tuple[Table, ...] = ()
  said: tuple[str, ...] = ()
  first: str = ""


def joined(tables: Sequence[Table]) -> Joined:
  """The drives that files hold: all of them one, a file of each kind or topic a drive, or each a drive of its own.

  Raises:
    RecordingError: commands and motion lie in files of their own, and which belong together cannot be told.
  """
  if (whole := by_topic(tables, JOINED)) is not None:
    return Joined(whole.tables, whole.tables, whole.said)
  each = [Columns((table,)) for table in tables] if len(tables) > 1 else []
  parts = [part_of(table, columns) for table, columns in zip(tables, each, strict=False)]
  drives = paired(parts) if parts else None
  if drives is not None:
    several = len(drives.groups) > 1
    made = tuple(
      _merged(group[0][0].stem + f"_{JOINED}" if several else JOINED, group, drives.prefixes) for group in drives.groups
    )
    said = (*drives.said, *(note for table in made for note in table.notes))
    return Joined(made, made, said, "" if several else drives.groups[0][0][0].label)
  if (one := as_one_drive(tables)) is not None:
    names = ", ".join(table.label for table in tables)
    return Joined((one,), (one,), (f"{names}: parts of one drive, joined by their clocks", *one.notes))
  return Joined(tuple(tables))


def as_one_drive(tables: Sequence[Table]) -> Table | None:
  """The files' columns as `file.column` in one table; None where they are drives of their own, or cannot be joined.

  They are parts of one drive where each has a clock, their times overlap, and commands and motion are together in all
  of them: in none alone, or in files of different columns, where one of the two may have names that nobody knows. Files
  of the same columns are drives of their own.
  """
  return topics_of_one_drive(tables, [Columns((table,)) for table in tables]) if len(tables) > 1 else None


def topics_of_one_drive(tables: Sequence[Table], each: Sequence[Columns], topics: bool = False) -> Table | None:
  """The same of files whose columns are known, one by one.

  Args:
    topics: whether the files' names say that they are topics of one run, as where the next run's are called alike.
  """
  groups: list[Clocked] = []
  apart = _of_different_names(each)
  guessed = [guess_columns(columns) for columns in each]
  for table, columns, guesses in zip(tables, each, guessed, strict=True):
    whole_drive = _has(guesses, COMMANDS) and _has(guesses, MOTION)
    if "time" not in guesses or (whole_drive and not apart and _logged_again(columns, each)):
      return None
    groups.append(clocked(columns, guesses["time"], Path(table.label).stem))
  if not groups or any(not group.time.size for group in groups):
    return None
  dated = all(group.time[0] > _DATE for group in groups)  # no two drives of a car are at one time
  if not (apart or dated or topics or _topics_of_one_log(tables, each)):
    return None
  shared = min(g.time[-1] for g in groups) - max(g.time[0] for g in groups)
  if shared < _TOGETHER * max(g.time[-1] - g.time[0] for g in groups):
    return None
  try:
    whole = merge(JOINED, groups)
  except RecordingError:
    return None
  guesses = guess_columns(Columns((whole,)))
  known = [_has(guesses, channels) for channels in (COMMANDS, MOTION)]
  return whole if all(known) or ((apart or dated or topics) and any(known)) else None


def as_csv(table: Table) -> str:
  """The text of a table, blank where there is no sample."""
  text = io.StringIO()
  print(*(f'"{name}"' for name in table.columns), sep=",", file=text)
  cells = [[_cell(value) for value in column.tolist()] for column in table.columns.values()]
  for row in zip(*cells, strict=True):
    print(*row, sep=",", file=text)
  return text.getvalue()


def _cell(value: object) -> str:
  if isinstance(value, float):
    return "" if np.isnan(value) else repr(value)
  return "" if value is None else '"' + str(value).replace('"', '""') + '"'


def _merged(name: str, group: Group, prefixes: Mapping[str, str]) -> Table:
  """One table of files, each on the drive's clock."""
  parts = [(clocked(part.columns, part.guesses["time"], prefixes[part.label]), clock) for part, clock in group]
  return merge(name, [Clocked(clock.rate * own.time + clock.shift, own.columns) for own, clock in parts])


def _of_different_names(each: Sequence[Columns]) -> bool:
  """Whether no two files share half of their columns and more, but for clocks: drives of their own are logged alike."""
  own = [{name for name in columns.names if not columns.rises(name) and not is_clock(name)} for columns in each]
  pairs = ((one, other) for k, one in enumerate(own) for other in own[:k])
  return all(len(one & other) < _ALIKE * min(len(one), len(other)) for one, other in pairs)


def _logged_again(columns: Columns, each: Sequence[Columns]) -> bool:
  """Whether another file has half of these columns and more: of a drive's telemetry, which has a command and its
  answer, there is one."""
  names = {name for name in columns.names if not columns.rises(name) and not is_clock(name)}
  others = ({*other.names} for other in each if other is not columns)
  return any(len(names & other) >= _ALIKE * min(len(names), len(other)) for other in others)


def _topics_of_one_log(tables: Sequence[Table], each: Sequence[Columns]) -> bool:
  """Whether files of the same columns are a log's topics, as an autopilot's `log_7_vehicle_acceleration_0.csv` and
  `log_7_vehicle_angular_velocity_0.csv`: all names share their numbers and a word, and differ by words alone."""
  names = {}
  for table, columns in zip(tables, each, strict=True):
    names.setdefault(frozenset(columns.names), []).append(words_of_file(Path(table.label).stem))
  if all(len(alike) == 1 for alike in names.values()):
    return True
  every = [words for alike in names.values() for words in alike]
  numbers = {tuple(word for word in words if word.isdigit()) for words in every}
  shared = set.intersection(*(set(words) for words in every))
  return len(names) > 1 and len(numbers) == 1 and bool(shared) and len(set(every)) == len(every)


def _has(guesses: Mapping[str, Guess], channels: Sequence[str]) -> bool:
  return any(name in guesses for name in channels)
