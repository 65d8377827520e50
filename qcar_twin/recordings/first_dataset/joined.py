"""Files that hold parts of one drive, a topic each, as one log: rows by their clocks, blank where one has no sample."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, guess_columns
from qcar_twin.recordings.first_dataset.names import readings
from qcar_twin.recordings.formats.table import Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError

JOINED = "joined.csv"
_COMMANDS = (*DRIVE_COMMANDS, "steering_command")
_MOTION = ("motor_speed", "speed", "pose_x", "yaw_rate")
# of the longest file's time, during which all of them have rows: parts of one drive begin and end alike
_TOGETHER = 0.5


def as_one_drive(tables: Sequence[Table]) -> Table | None:
  """The files' columns as `file.column` in one table; None where they are drives of their own, or cannot be joined.

  They are parts of one drive where each has a clock, their times overlap, and commands and motion are together in all
  of them: in none alone, or in files that share no column but clocks.
  """
  groups: list[Clocked] = []
  each = [Columns((table,)) for table in tables] if len(tables) > 1 else []
  apart = _of_different_names(each)
  for table, columns in zip(tables, each, strict=False):
    guesses = guess_columns(columns)
    whole_drive = _has(guesses, _COMMANDS) and _has(guesses, _MOTION)
    if "time" not in guesses or (whole_drive and not apart):
      return None
    groups.append(_clocked(table, columns, guesses["time"]))
  if not groups or any(not group.time.size for group in groups):
    return None
  shared = min(g.time[-1] for g in groups) - max(g.time[0] for g in groups)
  if shared < _TOGETHER * max(g.time[-1] - g.time[0] for g in groups):
    return None
  try:
    whole = merge(JOINED, groups)
  except RecordingError:
    return None
  guesses = guess_columns(Columns((whole,)))
  return whole if _has(guesses, _COMMANDS) and _has(guesses, _MOTION) else None


def as_csv(table: Table) -> str:
  """The text of a table, blank where there is no sample."""
  text = io.StringIO()
  print(*(f'"{name}"' for name in table.columns), sep=",", file=text)
  cells = [["" if np.isnan(v) else repr(v) for v in column.tolist()] for column in table.columns.values()]
  for row in zip(*cells, strict=True):
    print(*row, sep=",", file=text)
  return text.getvalue()


def _of_different_names(each: Sequence[Columns]) -> bool:
  """Whether no two files have a column of one name, but for clocks: drives of their own are logged alike."""
  own = [{name for name in columns.names if not columns.rises(name) and not _tells_time(name)} for columns in each]
  return sum(map(len, own)) == len(set().union(*own))


def _tells_time(name: str) -> bool:
  return any(reading.channel == "time" for reading in readings(name))


def _has(guesses: dict[str, Guess], channels: Sequence[str]) -> bool:
  return any(name in guesses for name in channels)


def _clocked(table: Table, columns: Columns, clock: Guess) -> Clocked:
  """A file's columns on its clock in s; its name before each, since a topic's columns are often called `data`."""
  known = columns.tables[0]
  time = clock.scale * known.number(clock.column, "time")
  names = [n for n in columns.names if n != clock.column and not _tells_time(n)]
  stem = Path(table.label).stem
  return Clocked(time, {f"{stem}.{name}": known.number(name, name) for name in names})
