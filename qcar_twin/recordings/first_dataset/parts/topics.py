"""Files of a topic each, of several drives: which drive and which topic each is of, and one log of every drive."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import PurePosixPath

from qcar_twin.recordings.first_dataset.columns import Guess
from qcar_twin.recordings.first_dataset.parts.pairing import Part, clocked, part_of, shift_of
from qcar_twin.recordings.first_dataset.parts.torn import MANY, is_clock
from qcar_twin.recordings.formats.table import Clocked, Table, merge
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.row_clock import DATED

_TOPICS = 3  # of a drive; two kinds of files are a car's log and a motion capture's, which names, clock or motion pair
_COMPLETE = 0.5  # of all topics that a drive has at least, and of all drives that a topic is of
_ALIKE = 0.5  # of the columns of the file with fewer: a message of one kind may repeat a name of another
_TOGETHER = 0.5  # of the shorter file's time, during which two of one clock both have rows
_WORD = re.compile(r"[a-zA-Z]+|\d+")
Named = Mapping[str, tuple[str, str]]  # by file its drive and its topic


def drives_and_topics(files: Sequence[str]) -> Named | None:
  """What each file is of by the names alone; None where they don't tell.

  The drive is the folder (`run1/imu.csv`), the words that names begin with (`take1_imu.csv`), or those that they end
  with (`imu_take1.csv`): the fewest that leave the same topics, three and more, to two drives and more, and what all
  topics have there besides.
  """
  splits = list(_splits(files))
  first = next((k for k, named in enumerate(splits) if _repeated(named)), None)
  if first is None:
    return None
  alike = [named for named in splits[first:] if _drives(named) == _drives(splits[first]) and _repeated(named)]
  return alike[-1]


def _drives(named: Named) -> set[frozenset[str]]:
  """The files of each drive."""
  drives: dict[str, set[str]] = {}
  for file, (drive, _) in named.items():
    drives.setdefault(drive, set()).add(file)
  return {frozenset(files) for files in drives.values()}


def _splits(files: Sequence[str]) -> Iterator[dict[str, tuple[str, str]]]:
  """Every way to part all names alike, folders first."""
  paths = {file: PurePosixPath(file) for file in files}
  if all(len(path.parts) > 1 for path in paths.values()):
    yield {file: ("_".join(path.parent.parts), path.stem) for file, path in paths.items()}
  stems = {file: "_".join(path.with_suffix("").parts) for file, path in paths.items()}
  words = {file: list(_WORD.finditer(stem)) for file, stem in stems.items()}
  least = min((len(each) for each in words.values()), default=0)
  for count in range(1, least):
    yield _parted(stems, {file: each[count].start() for file, each in words.items()}, drive_first=True)
  for count in range(1, least):
    yield _parted(stems, {file: each[-count].start() for file, each in words.items()}, drive_first=False)


def _parted(stems: Mapping[str, str], at: Mapping[str, int], drive_first: bool) -> dict[str, tuple[str, str]]:
  out = {}
  for file, stem in stems.items():
    parts = [part.strip("_-. ") for part in (stem[: at[file]], stem[at[file] :])]
    out[file] = (parts[0], parts[1]) if drive_first else (parts[1], parts[0])
  return out


def _repeated(named: Named) -> bool:
  """Whether each drive has most of the topics once, and each topic most of the drives."""
  drives: dict[str, set[str]] = {}
  for drive, topic in named.values():
    drives.setdefault(drive, set()).add(topic)
  topics = set().union(*drives.values())
  if len(drives) < 2 or len(topics) < _TOPICS or len(set(named.values())) < len(named) or "" in topics | drives.keys():
    return False
  of_topic = {topic: sum(topic in own for own in drives.values()) for topic in topics}
  return min(map(len, drives.values())) >= max(2, _COMPLETE * len(topics)) and min(of_topic.values()) >= max(
    2, _COMPLETE * len(drives)
  )


@dataclass(frozen=True)
class Whole:
  """Drives that were put together of their topics: a table each, and a line on each and on what was left out."""

  tables: tuple[Table, ...]
  said: tuple[str, ...]


def by_topic(tables: Sequence[Table], ending: str) -> Whole | None:
  """A log for every drive whose topics are in files of their own, called after the drive and `ending`; None where names
  don't say so, or a drive's files are drives themselves.

  Files of one clock are joined by it; those of another device's, by what both felt.

  Raises:
    RecordingError: the clocks of one drive's files don't lie together, and the motion doesn't say how they lie.
  """
  named = drives_and_topics([table.label for table in tables])
  if named is None:
    return None
  parts = {table.label: part_of(table) for table in tables}
  drives: dict[str, list[Part]] = {}
  topics: dict[str, list[Part]] = {}
  for label, (drive, topic) in named.items():
    drives.setdefault(drive, []).append(parts[label])
    topics.setdefault(topic, []).append(parts[label])
  if not all(alike(one, other) for kind in topics.values() for one, other in pairwise(kind)):
    return None
  whole = [[part for part in drive if part.whole] for drive in drives.values()]
  if any(alike(one, other) for drive in whole for one, other in combinations(drive, 2)):
    return None
  made, said = [], []
  for drive, files in drives.items():
    table, lines = _joined(f"{drive}_{ending}", files, {label: topic for label, (_, topic) in named.items()})
    made += [table] if table is not None else []
    said += lines
  return Whole(tuple(made), tuple(said)) if made else None


def alike(one: Part, other: Part) -> bool:
  """Whether two files share half of their columns and more, but for clocks: they were logged alike."""
  own, others = ({n for n in part.columns.names if not is_clock(n)} for part in (one, other))
  return len(own & others) >= _ALIKE * min(len(own), len(others))


def _joined(name: str, files: Sequence[Part], topics: Mapping[str, str]) -> tuple[Table | None, list[str]]:
  """One log of a drive's files, None where none has a clock, and what is to be said of them."""
  clocks: dict[str, list[Part]] = {}
  for part in files:
    if (clock := _clock(part)) is not None:
      dated = part.columns.tables[0].number(clock.column, "time")[0] * clock.scale > DATED
      clocks.setdefault("" if dated else clock.column, []).append(part)
  said = [f"{p.label}: left out, no column is a clock" for p in files if _clock(p) is None]
  if not clocks:
    return None, said
  devices = [_of_one_clock(own, topics) for own in clocks.values()]
  devices.sort(key=lambda device: (-device[0].commands, -device[0].motion))
  (first, groups), *others = devices
  for other, late in others:
    shift, how = shift_of(first, other)
    groups += [Clocked(group.time + shift, group.columns) for group in late]
    said.append(f"{first.label} and {other.label}: parts of one drive by their names, joined by {how}")
  if not others:
    said.append(f"{first.label}: parts of one drive by their names, joined by their clocks")
  table = merge(name, groups)
  return table, [*said, *table.notes]


def _clock(part: Part) -> Guess | None:
  """What says when a file's rows were; None where nothing does: in a few rows some number rises by chance."""
  clock = part.guesses.get("time")
  return clock if clock and (part.columns.tables[0].rows >= MANY or is_clock(clock.column)) else None


def _of_one_clock(files: Sequence[Part], topics: Mapping[str, str]) -> tuple[Part, list[Clocked]]:
  """The files of one clock as a part of their drive, and each one's samples.

  Raises:
    RecordingError: two of them have hardly any time in common.
  """
  groups = [clocked(part.columns, part.guesses["time"], topics[part.label]) for part in files]
  for (one, own), (other, others) in combinations(zip(files, groups, strict=True), 2):
    shared = min(own.time[-1], others.time[-1]) - max(own.time[0], others.time[0])
    if shared < _TOGETHER * min(own.time[-1] - own.time[0], others.time[-1] - others.time[0]):
      raise RecordingError(
        f"{one.label} and {other.label}: are of one drive by their names, and their clocks hardly meet"
        f" ({own.time[0]:.9g} to {own.time[-1]:.9g} s, {others.time[0]:.9g} to {others.time[-1]:.9g} s); bring both to"
        " one clock, leave one of them out, or rename it after the drive that it is of"
      )
  label = ", ".join(part.label for part in files)
  return part_of(merge(label, groups)), groups
