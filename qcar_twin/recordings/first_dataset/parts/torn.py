"""Logs that hold parts of one drive: commands in one file, what the car did in another."""

from collections.abc import Mapping, Sequence

from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, guess_columns
from qcar_twin.recordings.first_dataset.names import readings
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.recording import RecordingError

COMMANDS, MOTION = (*DRIVE_COMMANDS, "steering_command"), ("motor_speed", "speed", "pose_x", "yaw_rate")
MANY = 20  # rows: among fewer some number that is no clock rises by chance, and nobody drives for so few
_SHOWN = 80  # letters of a list of files


def refuse_parts(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """Raises RecordingError where commands and motion of one drive lie in files of their own."""
  commands = {guesses[name].column for name in COMMANDS if name in guesses}
  motion = {guesses[name].column for name in MOTION if name in guesses}
  parts = {
    table.label: (bool(commands & set(table.columns)), bool(motion & set(table.columns))) for table in columns.tables
  }
  if len(parts) < 2 or any(all(part) for part in parts.values()):
    return
  if commands and motion:
    lists = [", ".join(label for label, part in parts.items() if part[k])[:_SHOWN] for k in (0, 1)]
    said = f"commands are in {lists[0]} and what the car did in {lists[1]}"
  elif _nothing_shared(columns.tables):
    said = f"{', '.join(parts)[:_SHOWN]} share no column but a clock, as parts of one drive do"
  else:
    return
  raise RecordingError(
    f"{said}: join the files of one drive by their clock into one, with blank cells where there is no sample, as "
    f'pandas.merge(a, b, on="time", how="outer") does{_other_clocks(columns.tables)}'
  )


def _nothing_shared(tables: Sequence[Table]) -> bool:
  """Whether no two logs have a column in common that is no clock."""
  named = [{name for name in table.columns if not is_clock(name)} for table in tables]
  return all(not a & b for k, a in enumerate(named) for b in named[:k])


def is_clock(name: str) -> bool:
  """Whether a column's name says time."""
  return name == "time" or any(reading.channel == "time" for reading in readings(name))


def _other_clocks(tables: Sequence[Table]) -> str:
  """What to do first where the logs' clocks have no time in common."""
  spans: dict[str, tuple[float, float]] = {}
  for table in tables:
    clock = guess_columns(alone := Columns((table,))).get("time")
    if clock is not None:
      values = clock.scale * alone.values(clock.column)
      spans[table.label] = float(values.min()), float(values.max())
  for one, (begin, end) in spans.items():
    other = next((name for name, (a, b) in spans.items() if a > end or b < begin), None)
    if other is not None:
      said = f"{one} has {begin:.9g} to {end:.9g} s, {other} {spans[other][0]:.9g} to {spans[other][1]:.9g} s"
      return f"; their clocks have no time in common ({said}): bring them to one first"
  return ""
